"""Effects of the measurement: gain, mass, cross-axis share, delay, filters, converter, hum, clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import exp, pi
from statistics import median
from typing import Any

from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.effects.changes import Change, Sites, added
from nmt_diagnose.effects.effect import Effect, EffectParameter, Site
from nmt_diagnose.effects.location import Location, LocationKind
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, SensorSection, TransverseSection
from nmt_signals.channel_faults.mains_lines import MAINS_HZ

RESPONSES = ("displacement", "velocity", "acceleration")
ALL = (*RESPONSES, "force")
MEASUREMENT = "Ewins, Modal Testing (2000)"

_STEP_BITS = 20


def _sensors(rig: Rig, quantities: tuple[str, ...]) -> list[tuple[int, SensorSection, str]]:
    return [
        (index, sensor, rig.sensor_channel(sensor))
        for index, sensor in enumerate(rig.sensors)
        if sensor.quantity in quantities
    ]


def _site(rig: Rig, index: int, scales: Mapping[str, float], mains_hz: float = MAINS_HZ[0], **more: Any) -> Site:
    """At the channel of a sensor: at the force sensor where that channel is the force."""
    sensor = rig.sensors[index]
    kind: LocationKind = "force_sensor" if sensor.quantity == "force" else "response_sensor"
    point, picked_up = rig.sensor_point(sensor), more.get("other_point", 0)
    where = Location.on_channel(kind, rig.sensor_channel(sensor), point, picked_up, mains_hz)
    return Site(where, scales, point, index=index, **more)


def _per_channel(
    quantities: tuple[str, ...],
    name: str,
    scale: Callable[[OperatingRange, str], float],
    more: Callable[[OperatingRange, str], dict[str, Any]] = lambda operating, channel: {},
) -> Sites:
    """A site at each channel of some quantities; scale and what else a site has by the name of the channel."""

    def sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
        return tuple(
            _site(rig, index, {name: scale(operating, channel)}, **more(operating, channel))
            for index, _, channel in _sensors(rig, quantities)
        )

    return sites


def _set(**keys: Callable[[SensorSection, Site, Mapping[str, float]], float]) -> Change:
    """Change of some keys of a sensor."""

    def change(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
        sensor = rig.sensors[site.index]
        update = {key: value(sensor, site, values) for key, value in keys.items()}
        return with_value(rig, ("sensors", site.index), sensor.model_copy(update=update))

    return change


def _mass_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    found: dict[int, Site] = {}
    for index, sensor, _ in _sensors(rig, RESPONSES):
        point = rig.sensor_point(sensor)
        # Sensors at one point are one mass.
        existing = {"m": sensor.mass_kg} if sensor.mass_kg > 0.0 else {}
        found.setdefault(point, _site(rig, index, {"m": operating.typical_mass(point)}, existing=existing))
    return tuple(found.values())


def _force_mass_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    size = operating.typical_mass(rig.drive_point)
    return tuple(
        Site(
            Location("force_sensor"),
            {"m": size},
            rig.drive_point,
            index=index,
            existing={"m": sensor.mass_kg} if sensor.mass_kg > 0.0 else {},
        )
        for index, sensor, _ in _sensors(rig, ("force",))
    )


def _transverse_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    points = sorted({rig.sensor_point(sensor) for _, sensor, _ in _sensors(rig, RESPONSES)})
    return tuple(
        _site(rig, index, {"s": 0.02}, other_point=other)
        for index, sensor, _ in _sensors(rig, RESPONSES)
        for other in points
        if other != rig.sensor_point(sensor)
    )


def _with_transverse(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    section = TransverseSection.model_construct(point=site.other_point, fraction=values["s"])
    return with_value(rig, ("sensors", site.index, "transverse"), section)


def _clip_sites(rig: Rig, operating: OperatingRange) -> Iterable[Site]:
    """Where samples stand at a level, that is where the search begins; a record that shows none refutes it."""
    for index, sensor, channel in _sensors(rig, ALL):
        largest = operating.channels.get(channel, 0.0) * abs(sensor.gain)
        depth, level = THRESHOLDS.candidates.clip_depth, operating.limits.get(channel, 0.0)
        if level > 0.0:
            largest, depth = (
                level * exp(THRESHOLDS.candidates.clip_depth_at_level),
                THRESHOLDS.candidates.clip_depth_at_level,
            )
        if largest > 0.0 and channel not in operating.unclipped:
            yield _site(rig, index, {"depth": depth}, reference=largest)


def _clip_level(site: Site, values: Mapping[str, float]) -> float:
    return site.reference * exp(-values["depth"])


def _step_sites(rig: Rig, operating: OperatingRange) -> Iterable[Site]:
    """Where samples show a step, that is where the search begins; otherwise one that hides the lowest level."""
    for index, sensor, channel in _sensors(rig, ALL):
        lowest = operating.channels_low.get(channel, 0.0) * abs(sensor.gain)
        step = operating.steps.get(channel, lowest)
        if step > 0.0:
            yield _site(rig, index, {"lsb": step})


def _hum_sites(rig: Rig, operating: OperatingRange) -> Iterable[Site]:
    for index, sensor, channel in _sensors(rig, ALL):
        scale = {"amplitude": 0.01 * operating.channels_low.get(channel, 1.0)}
        for hz in MAINS_HZ:
            # A sensor has one line.
            if sensor.hum_amplitude == 0.0 or sensor.hum_hz == hz:
                yield _site(rig, index, scale, hz, reference=hz)


def late_channels(operating: OperatingRange, channels: Sequence[str]) -> tuple[float, ...]:
    """Common delay of channels that a fit from zero would not reach, s; none where it would."""
    known = [operating.delays[name] for name in channels if name in operating.delays]
    delay = median(known) if known else 0.0
    return (delay,) if abs(delay) * operating.omega > THRESHOLDS.candidates.large_delay_phase_rad else ()


def _group_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Responses of one quantity, which share a conditioner, where there are several."""
    groups: dict[str, list[str]] = {}
    for _, sensor, channel in _sensors(rig, RESPONSES):
        groups.setdefault(sensor.quantity, []).append(channel)
    scale = {"tau": 0.005 / operating.omega}
    return tuple(
        Site(
            Location("response_sensor", detail=f"{quantity} channels"), scale, option=quantity,
            starts={"tau": late_channels(operating, channels)},
        )
        for quantity, channels in groups.items()
        if len(channels) > 1
    )  # fmt: skip


def _delayed(rig: Rig, quantities: tuple[str, ...], delay_s: float) -> Rig:
    sensors = [
        s.model_copy(update={"delay_s": s.delay_s + delay_s}) if s.quantity in quantities else s for s in rig.sensors
    ]
    return rig.model_copy(update={"sensors": sensors})


def _hold_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Without a recorded voltage the moment at which the drive acts is unknown."""
    if not _sensors(rig, ("voltage",)):
        return ()
    late = late_channels(operating, [channel for _, _, channel in _sensors(rig, ALL)])
    starts = {"hold": tuple(2.0 * delay for delay in late if delay > 0.0)}
    return (Site(Location("exciter", detail="drive"), {"hold": 0.01 / operating.omega}, starts=starts),)


def _with_hold(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    """Late against the recorded voltage is everything that the drive moves."""
    return _delayed(rig, (*ALL, "current"), 0.5 * values["hold"])


def _corner_hz(values: Mapping[str, float]) -> float:
    """Corner of a low-pass, Hz; infinite without one."""
    tau = values["time_constant"]
    return 1.0 / (2.0 * pi * tau) if tau > 0.0 else float("inf")


def _effect(name: str, equation: str, keys: str, parameter: EffectParameter, **more: Any) -> Effect:
    """An effect of a channel, of the measurement's own reference unless another is given."""
    defaults: dict[str, Any] = {"place": "response_sensor", "reference": MEASUREMENT}
    return Effect(name=name, equation=equation, keys=keys, parameters=(parameter,), **(defaults | more))


def _factor(values: Mapping[str, float]) -> float:
    """1 + g, no further from 1 than a sensor whose unit is stated can be."""
    largest = THRESHOLDS.candidates.largest_gain_factor
    return min(max(1.0 + values["g"], 1.0 / largest), largest)


def _gain(name: str, equation: str, place: LocationKind, quantities: tuple[str, ...], other: str) -> Effect:
    return _effect(
        name, equation, "sensors.gain", EffectParameter("g", "1", signed=True), place=place,
        sites=_per_channel(quantities, "g", lambda operating, channel: 0.02),
        change=_set(gain=lambda sensor, site, values: sensor.gain * _factor(values)),
        report=lambda site, values: {"g": (_factor(values) - 1.0, "1")},
        equivalents={other: "a random test with the voltage as reference"},
    )  # fmt: skip


def _mass(name: str, equation: str, sites: Sites, **more: Any) -> Effect:
    return _effect(
        name, equation, "sensors.mass_kg", EffectParameter("m", "kg"), sites=sites,
        change=_set(mass_kg=lambda sensor, site, values: sensor.mass_kg + values["m"]), **more,
    )  # fmt: skip


SENSOR_EFFECTS: tuple[Effect, ...] = (
    _gain("force_gain", "F (1 + g)", "force_sensor", ("force",), "response_gain"),
    _mass(
        "force_cell_mass", "F + m a", _force_mass_sites, place="force_sensor",
        reference="Ewins, Modal Testing (2000), mass cancellation",
    ),
    _gain("response_gain", "y (1 + g)", "response_sensor", RESPONSES, "force_gain"),
    _effect(
        "transverse_sensitivity", "y + s y⊥ (y of another point)", "sensors.transverse",
        EffectParameter("s", "1", signed=True), reference="ISO 16063-31 (2009)",
        sites=_transverse_sites, change=_with_transverse,
        equivalents={"response_gain": "several modes in a random test"}, ordinary=TOLERANCES.transverse,
    ),
    _mass(
        "sensor_mass", "m a at the sensor's point", _mass_sites,
        equivalents={"added_mass": "a test with the sensor taken off"},
    ),
    _effect(
        "channel_skew", "e^{−iωτ}", "sensors.delay_s", EffectParameter("tau", "s", signed=True),
        sites=_per_channel(
            ALL, "tau", lambda operating, channel: 0.005 / operating.omega,
            lambda operating, channel: {"starts": {"tau": late_channels(operating, (channel,))}},
        ),
        change=_set(delay_s=lambda sensor, site, values: sensor.delay_s + values["tau"]),
        equivalents={"low_pass": "a random test"},
    ),
    _effect(
        "shared_delay", "e^{−iωτ} in all channels of a quantity", "sensors.delay_s of the group",
        EffectParameter("tau", "s", signed=True), sites=_group_sites,
        change=lambda rig, site, values: _delayed(rig, (site.option,), values["tau"]),
        equivalents={"channel_skew": "a random test"},
    ),
    _effect(
        "drive_hold", "zero-order hold of T: the drive acts T/2 later than recorded, e^{−iωT/2}",
        "sensors.delay_s of force and responses", EffectParameter("hold", "s"), place="exciter",
        reference="Franklin, Powell and Workman, Digital Control of Dynamic Systems (1998)",
        sites=_hold_sites, change=_with_hold,
        equivalents={"shared_delay": "a record of the drive behind the converter"},
    ),
    _effect(
        "low_pass", "1/(1 + iω/ω_c), strength 1/ω_c", "sensors.low_pass_hz",
        EffectParameter("time_constant", "s", grid=(1.0, 3.0, 10.0)),
        sites=_per_channel(ALL, "time_constant", lambda operating, channel: 0.005 / operating.omega),
        change=_set(low_pass_hz=lambda sensor, site, values: _corner_hz(values)),
        report=lambda site, values: {"low_pass_hz": (_corner_hz(values), "Hz")},
        equivalents={"channel_skew": "a random test"},
    ),
    _effect(
        "charge_high_pass", "iω/(iω + 2πf_h)", "sensors.high_pass_hz",
        EffectParameter("f_h", "Hz", grid=(0.3, 1.0, 3.0)),
        sites=_per_channel(ALL, "f_h", lambda operating, channel: 0.005 * operating.omega / (2.0 * pi)),
        change=_set(high_pass_hz=lambda sensor, site, values: values["f_h"]),
    ),
    _effect(
        "clipping", "clip(y, ±A e^{−depth}), A > amplitudes of all tests", "sensors.clip",
        EffectParameter("depth", "1", grid=(0.5, 1.0, 2.0, 4.0)),
        sites=lambda rig, operating: tuple(_clip_sites(rig, operating)),
        change=_set(clip=lambda sensor, site, values: _clip_level(site, values)),
        report=lambda site, values: {"level": (_clip_level(site, values), "channel")},
    ),
    _effect(
        "quantisation", "LSB · round(y/LSB)", "sensors.bits, sensors.range",
        EffectParameter("lsb", "channel", grid=(0.3, 1.0, 1.8)),
        reference="Widrow and Kollár, Quantization Noise (2008)",
        sites=lambda rig, operating: tuple(_step_sites(rig, operating)),
        change=_set(
            bits=lambda sensor, site, values: _STEP_BITS,
            range=lambda sensor, site, values: values["lsb"] * 2.0 ** (_STEP_BITS - 1),
        ),
    ),
    _effect(
        "mains_hum", "y + A cos(2π 50 t), or 60", "sensors.hum_amplitude, sensors.hum_hz",
        EffectParameter("amplitude", "channel"), sites=lambda rig, operating: tuple(_hum_sites(rig, operating)),
        change=_set(
            hum_amplitude=lambda sensor, site, values: sensor.hum_amplitude + values["amplitude"],
            hum_hz=lambda sensor, site, values: site.reference,
        ),
    ),
    _effect(
        "clock_error", "f (1 + e)", "clock_error", EffectParameter("e", "1", signed=True),
        reference="IEEE Std 1057 (2017)",
        sites=lambda rig, operating: (Site(Location("response_sensor"), {"e": 1e-3}),),
        change=added("e", "clock_error"),
        equivalents={"youngs_modulus": "a reference clock"},
    ),
)  # fmt: skip
