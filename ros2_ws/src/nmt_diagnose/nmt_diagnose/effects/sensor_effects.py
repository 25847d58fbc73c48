"""Effects of the measurement: gain, mass, cross-axis share, delay, filters, converter, hum, clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import exp, pi
from statistics import median

from nmt_diagnose.effects.effect import Effect, EffectParameter, Reported, Site
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.placement import EUROPEAN_MAINS_HZ, PlaceKind, Placement
from nmt_diagnose.effects.rig_edit import value_at, with_value
from nmt_rig.rig import Rig, SensorSection, TransverseSection

RESPONSES = ("displacement", "velocity", "acceleration")
MAINS_HZ = (EUROPEAN_MAINS_HZ, 60.0)
MEASUREMENT = "Ewins, Modal Testing (2000)"
Change = Callable[[Rig, Site, Mapping[str, float]], Rig]


# Turn of the motion under test by a delay from which a fit begins there, too, rad.
_MUCH_LATE = 0.3
# Depth of clipping that is looked at where no samples stand at a level; what depth counts from where they do.
_CLIP_DEPTH, _SEEN_DEPTH = 0.1, 0.5


def _sensors(rig: Rig, quantities: tuple[str, ...]) -> list[tuple[int, SensorSection, str]]:
    return [
        (index, sensor, rig.sensor_channel(sensor))
        for index, sensor in enumerate(rig.sensors)
        if sensor.quantity in quantities
    ]


def _placement(rig: Rig, sensor: SensorSection, picked_up: int = 0, mains_hz: float = MAINS_HZ[0]) -> Placement:
    """The channel of a sensor: at the force sensor where that channel is the force."""
    kind: PlaceKind = "force_sensor" if sensor.quantity == "force" else "response_sensor"
    return Placement.on_channel(kind, rig.sensor_channel(sensor), rig.sensor_point(sensor), picked_up, mains_hz)


def _per_channel(
    quantities: tuple[str, ...], name: str, scale: Callable[[OperatingRange, str], float]
) -> Callable[[Rig, OperatingRange], tuple[Site, ...]]:
    def sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
        return tuple(
            Site(_placement(rig, sensor), {name: scale(operating, channel)}, rig.sensor_point(sensor), index=index)
            for index, sensor, channel in _sensors(rig, quantities)
        )

    return sites


def _set(key: str, value: Callable[[SensorSection, Mapping[str, float]], float | None]) -> Change:
    def change(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
        sensor = rig.sensors[site.index]
        return with_value(rig, ("sensors", site.index, key), value(sensor, values))

    return change


def _mass_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    found: dict[int, Site] = {}
    for index, sensor, _ in _sensors(rig, RESPONSES):
        point = rig.sensor_point(sensor)
        # Sensors at one point are one mass.
        if point not in found:
            found[point] = Site(_placement(rig, sensor), {"m": operating.typical_mass(point)}, point, index=index)
    return tuple(found.values())


def _force_mass_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    size = operating.typical_mass(rig.drive_point)
    return tuple(
        Site(Placement("force_sensor"), {"m": size}, rig.drive_point, index=index)
        for index, _, _ in _sensors(rig, ("force",))
    )


def _transverse_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    points = sorted({rig.sensor_point(sensor) for _, sensor, _ in _sensors(rig, RESPONSES)})
    return tuple(
        Site(_placement(rig, sensor, other), {"s": 0.02}, rig.sensor_point(sensor), other, index)
        for index, sensor, _ in _sensors(rig, RESPONSES)
        for other in points
        if other != rig.sensor_point(sensor)
    )


def _with_transverse(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    section = TransverseSection.model_construct(point=site.other_point, fraction=values["s"])
    return with_value(rig, ("sensors", site.index, "transverse"), section)


def _clip_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Where samples stand at a level, that is where the search begins."""
    found = []
    for index, sensor, channel in _sensors(rig, (*RESPONSES, "force")):
        largest = operating.channels.get(channel, 0.0) * abs(sensor.gain)
        depth, level = _CLIP_DEPTH, operating.limits.get(channel, 0.0)
        if level > 0.0:
            largest, depth = level * exp(_SEEN_DEPTH), _SEEN_DEPTH
        if largest > 0.0:
            where = _placement(rig, sensor)
            found.append(Site(where, {"depth": depth}, rig.sensor_point(sensor), index=index, reference=largest))
    return tuple(found)


def _step_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Where samples show a step, that is where the search begins; otherwise one that hides the lowest level."""
    found = []
    for index, sensor, channel in _sensors(rig, (*RESPONSES, "force")):
        lowest = operating.channels_low.get(channel, 0.0) * abs(sensor.gain)
        step = operating.steps.get(channel, lowest)
        if step > 0.0:
            found.append(Site(_placement(rig, sensor), {"lsb": step}, rig.sensor_point(sensor), index=index))
    return tuple(found)


def _with_clip(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    return with_value(rig, ("sensors", site.index, "clip"), site.reference * exp(-values["depth"]))


def _clip_report(site: Site, values: Mapping[str, float]) -> Reported:
    return {"level": (site.reference * exp(-values["depth"]), "channel")}


def _with_lsb(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    sensor = rig.sensors[site.index]
    bits = 20
    changed = sensor.model_copy(update={"bits": bits, "range": values["lsb"] * 2.0 ** (bits - 1)})
    return with_value(rig, ("sensors", site.index), changed)


def _hum_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    found = []
    for index, sensor, channel in _sensors(rig, (*RESPONSES, "force")):
        for hz in MAINS_HZ:
            # A sensor has one line.
            if sensor.hum_amplitude == 0.0 or sensor.hum_hz == hz:
                scale = {"amplitude": 0.01 * operating.channels_low.get(channel, 1.0)}
                where = _placement(rig, sensor, mains_hz=hz)
                found.append(Site(where, scale, rig.sensor_point(sensor), index=index, reference=hz))
    return tuple(found)


def _with_hum(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    sensor = rig.sensors[site.index]
    changes = {"hum_amplitude": sensor.hum_amplitude + values["amplitude"], "hum_hz": site.reference}
    return with_value(rig, ("sensors", site.index), sensor.model_copy(update=changes))


def _late(operating: OperatingRange, channels: Sequence[str]) -> tuple[float, ...]:
    """Common delay of channels that a fit from zero would not reach, s; none where it would."""
    known = [operating.delays[name] for name in channels if name in operating.delays]
    delay = median(known) if known else 0.0
    return (delay,) if abs(delay) * operating.omega > _MUCH_LATE else ()


def _skew_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    sites = _per_channel((*RESPONSES, "force"), "tau", lambda operating, channel: 0.005 / operating.omega)
    return tuple(
        replace(site, starts={"tau": _late(operating, (rig.sensor_channel(rig.sensors[site.index]),))})
        for site in sites(rig, operating)
    )


def _group_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Responses of one quantity, which share a conditioner, where there are several."""
    groups: dict[str, list[str]] = {}
    for _, sensor, channel in _sensors(rig, RESPONSES):
        groups.setdefault(sensor.quantity, []).append(channel)
    scale = {"tau": 0.005 / operating.omega}
    return tuple(
        Site(
            Placement("response_sensor", detail=f"{quantity} channels"), scale, option=quantity,
            starts={"tau": _late(operating, channels)},
        )
        for quantity, channels in groups.items()
        if len(channels) > 1
    )  # fmt: skip


def _with_shared_delay(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    return _delayed(rig, (site.option,), values["tau"])


def _delayed(rig: Rig, quantities: tuple[str, ...], delay_s: float) -> Rig:
    sensors = [
        s.model_copy(update={"delay_s": s.delay_s + delay_s}) if s.quantity in quantities else s for s in rig.sensors
    ]
    return rig.model_copy(update={"sensors": sensors})


def _hold_sites(rig: Rig, operating: OperatingRange) -> tuple[Site, ...]:
    """Without a recorded voltage nothing tells when the drive acts."""
    if not _sensors(rig, ("voltage",)):
        return ()
    late = _late(operating, [channel for _, _, channel in _sensors(rig, (*RESPONSES, "force"))])
    starts = {"hold": tuple(2.0 * delay for delay in late if delay > 0.0)}
    return (Site(Placement("exciter", detail="drive"), {"hold": 0.01 / operating.omega}, starts=starts),)


def _with_hold(rig: Rig, site: Site, values: Mapping[str, float]) -> Rig:
    """Late against the recorded voltage is everything that the drive moves."""
    return _delayed(rig, (*RESPONSES, "force", "current"), 0.5 * values["hold"])


def _high_pass(sensor: SensorSection, values: Mapping[str, float]) -> float:
    return values["f_h"]


def _low_pass(sensor: SensorSection, values: Mapping[str, float]) -> float:
    return 1.0 / (2.0 * pi * values["time_constant"])


def _low_pass_report(site: Site, values: Mapping[str, float]) -> Reported:
    tau = values["time_constant"]
    return {"low_pass_hz": (1.0 / (2.0 * pi * tau) if tau > 0.0 else float("inf"), "Hz")}


def _chain_effect(
    name: str, equation: str, parameter: EffectParameter, key: str,
    value: Callable[[SensorSection, Mapping[str, float]], float | None],
    scale: Callable[[OperatingRange, str], float],
    report: Callable[[Site, Mapping[str, float]], Reported] | None = None,
    equivalents: Mapping[str, str] | None = None,
) -> Effect:  # fmt: skip
    return Effect(
        name=name,
        place="response_sensor",
        equation=equation,
        reference=MEASUREMENT,
        keys=f"sensors.{key}",
        parameters=(parameter,),
        sites=_per_channel((*RESPONSES, "force"), parameter.name, scale),
        change=_set(key, value),
        report=report,
        equivalents=equivalents or {},
    )


SENSOR_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="force_gain", place="force_sensor", equation="F (1 + g)", reference=MEASUREMENT, keys="sensors.gain",
        parameters=(EffectParameter("g", "1", signed=True),),
        sites=_per_channel(("force",), "g", lambda operating, channel: 0.02),
        change=_set("gain", lambda sensor, values: sensor.gain * (1.0 + values["g"])),
        equivalents={"response_gain": "a random test with the voltage as reference"},
    ),
    Effect(
        name="force_cell_mass", place="force_sensor", equation="F + m a", keys="sensors.mass_kg",
        reference="Ewins, Modal Testing (2000), mass cancellation",
        parameters=(EffectParameter("m", "kg", signed=True),),
        sites=_force_mass_sites,
        change=_set("mass_kg", lambda sensor, values: sensor.mass_kg + values["m"]),
    ),
    Effect(
        name="response_gain", place="response_sensor", equation="y (1 + g)", reference=MEASUREMENT,
        keys="sensors.gain", parameters=(EffectParameter("g", "1", signed=True),),
        sites=_per_channel(RESPONSES, "g", lambda operating, channel: 0.02),
        change=_set("gain", lambda sensor, values: sensor.gain * (1.0 + values["g"])),
        equivalents={"force_gain": "a random test with the voltage as reference"},
    ),
    Effect(
        name="transverse_sensitivity", place="response_sensor", equation="y + s y⊥ (y of another point)",
        reference="ISO 16063-31 (2009)", keys="sensors.transverse",
        parameters=(EffectParameter("s", "1", signed=True),),
        sites=_transverse_sites, change=_with_transverse,
        equivalents={"response_gain": "several modes in a random test"},
    ),
    Effect(
        name="sensor_mass", place="response_sensor", equation="m a at the sensor's point", keys="sensors.mass_kg",
        reference=MEASUREMENT, parameters=(EffectParameter("m", "kg", signed=True),),
        sites=_mass_sites,
        change=_set("mass_kg", lambda sensor, values: sensor.mass_kg + values["m"]),
        equivalents={"added_mass": "a test with the sensor taken off"},
    ),
    Effect(
        name="channel_skew", place="response_sensor", equation="e^{−iωτ}", reference=MEASUREMENT,
        keys="sensors.delay_s", parameters=(EffectParameter("tau", "s", signed=True),),
        sites=_skew_sites,
        change=_set("delay_s", lambda sensor, values: sensor.delay_s + values["tau"]),
        equivalents={"low_pass": "a random test"},
    ),
    Effect(
        name="shared_delay", place="response_sensor", equation="e^{−iωτ} in all channels of a quantity",
        reference=MEASUREMENT, keys="sensors.delay_s of the group",
        parameters=(EffectParameter("tau", "s", signed=True),),
        sites=_group_sites, change=_with_shared_delay,
        equivalents={"channel_skew": "a random test"},
    ),
    Effect(
        name="drive_hold", place="exciter",
        equation="drive held for T at a time: it acts T/2 later than recorded, e^{−iωT/2}",
        reference="Franklin, Powell and Workman, Digital Control of Dynamic Systems (1998)",
        keys="sensors.delay_s of force and responses",
        parameters=(EffectParameter("hold", "s"),),
        sites=_hold_sites, change=_with_hold,
        equivalents={"shared_delay": "a record of the drive behind the converter"},
    ),
    _chain_effect(
        "low_pass", "1/(1 + iω/ω_c), strength 1/ω_c",
        EffectParameter("time_constant", "s", grid=(1.0, 3.0, 10.0)), "low_pass_hz",
        _low_pass, lambda operating, channel: 0.005 / operating.omega, _low_pass_report,
        {"channel_skew": "a random test"},
    ),
    _chain_effect(
        "charge_high_pass", "iω/(iω + 2πf_h)", EffectParameter("f_h", "Hz", grid=(0.3, 1.0, 3.0)), "high_pass_hz",
        _high_pass, lambda operating, channel: 0.005 * operating.omega / (2.0 * pi),
    ),
    Effect(
        name="clipping", place="response_sensor", equation="clip(y, ±A e^{−depth}), A > amplitudes of all tests",
        reference=MEASUREMENT, keys="sensors.clip",
        parameters=(EffectParameter("depth", "1", grid=(0.5, 1.0, 2.0, 4.0)),),
        sites=_clip_sites, change=_with_clip, report=_clip_report,
    ),
    Effect(
        name="quantisation", place="response_sensor", equation="LSB · round(y/LSB)",
        reference="Widrow and Kollár, Quantization Noise (2008)", keys="sensors.bits, sensors.range",
        parameters=(EffectParameter("lsb", "channel", grid=(0.3, 1.0, 1.8)),),
        sites=_step_sites, change=_with_lsb,
    ),
    Effect(
        name="mains_hum", place="response_sensor", equation="y + A cos(2π 50 t), or 60", reference=MEASUREMENT,
        keys="sensors.hum_amplitude, sensors.hum_hz", parameters=(EffectParameter("amplitude", "channel"),),
        sites=_hum_sites, change=_with_hum,
    ),
    Effect(
        name="clock_error", place="response_sensor", equation="f (1 + e)", keys="clock_error",
        reference="IEEE Std 1057 (2017)",
        parameters=(EffectParameter("e", "1", signed=True),),
        sites=lambda rig, operating: (Site(Placement("response_sensor"), {"e": 1e-3}),),
        change=lambda rig, site, values: with_value(
            rig, ("clock_error",), value_at(rig, ("clock_error",)) + values["e"]
        ),
        equivalents={"youngs_modulus": "a reference clock"},
    ),
)  # fmt: skip
