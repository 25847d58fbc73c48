"""Effects of the measurement: gain, mass, cross-axis share, delay, filters, converter, hum, clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import exp, pi

from nmt_diagnose.effects.effect import Effect, EffectParameter, Place, Placement, Reported
from nmt_diagnose.effects.operating_range import OperatingRange
from nmt_diagnose.effects.rig_edit import value_at, with_value
from nmt_rig.rig import Rig, SensorSection, TransverseSection

RESPONSES = ("displacement", "velocity", "acceleration")
MAINS_HZ = (50.0, 60.0)
MEASUREMENT = "Ewins, Modal Testing (2000)"
Change = Callable[[Rig, Placement, Mapping[str, float]], Rig]


def _sensors(rig: Rig, quantities: tuple[str, ...]) -> list[tuple[int, SensorSection, str]]:
    return [
        (index, sensor, rig.sensor_channel(sensor))
        for index, sensor in enumerate(rig.sensors)
        if sensor.quantity in quantities
    ]


def _per_channel(
    quantities: tuple[str, ...], name: str, scale: Callable[[OperatingRange, str], float]
) -> Callable[[Rig, OperatingRange], tuple[Placement, ...]]:
    def placements(rig: Rig, operating: OperatingRange) -> tuple[Placement, ...]:
        return tuple(
            Placement(channel, {name: scale(operating, channel)}, rig.sensor_point(sensor), index=index,
                      channel=channel)
            for index, sensor, channel in _sensors(rig, quantities)
        )  # fmt: skip

    return placements


def _set(key: str, value: Callable[[SensorSection, Mapping[str, float]], float | None]) -> Change:
    def change(rig: Rig, placement: Placement, values: Mapping[str, float]) -> Rig:
        sensor = rig.sensors[placement.index]
        return with_value(rig, ("sensors", placement.index, key), value(sensor, values))

    return change


def _mass_placements(rig: Rig, operating: OperatingRange) -> tuple[Placement, ...]:
    found: dict[int, Placement] = {}
    for index, sensor, channel in _sensors(rig, RESPONSES):
        point = rig.sensor_point(sensor)
        # Sensors at one point are one mass.
        if point not in found:
            found[point] = Placement(channel, {"m": operating.typical_mass(point)}, point, index=index, channel=channel)
    return tuple(found.values())


def _force_mass_placements(rig: Rig, operating: OperatingRange) -> tuple[Placement, ...]:
    size = operating.typical_mass(rig.drive_point)
    return tuple(
        Placement("", {"m": size}, rig.drive_point, index=index, channel=channel)
        for index, _, channel in _sensors(rig, ("force",))
    )


def _transverse_placements(rig: Rig, operating: OperatingRange) -> tuple[Placement, ...]:
    points = sorted({rig.sensor_point(sensor) for _, sensor, _ in _sensors(rig, RESPONSES)})
    return tuple(
        Placement(f"{channel}<{other}", {"s": 0.02}, rig.sensor_point(sensor), other, index, channel=channel)
        for index, sensor, channel in _sensors(rig, RESPONSES)
        for other in points
        if other != rig.sensor_point(sensor)
    )


def _with_transverse(rig: Rig, placement: Placement, values: Mapping[str, float]) -> Rig:
    section = TransverseSection.model_construct(point=placement.other_point, fraction=values["s"])
    return with_value(rig, ("sensors", placement.index, "transverse"), section)


def _limit_placements(low: bool) -> Callable[[Rig, OperatingRange], tuple[Placement, ...]]:
    name = "lsb" if low else "depth"

    def placements(rig: Rig, operating: OperatingRange) -> tuple[Placement, ...]:
        amplitudes = operating.channels_low if low else operating.channels
        return tuple(
            Placement(
                channel,
                {name: amplitudes[channel] * abs(sensor.gain) if low else 0.1},
                rig.sensor_point(sensor),
                index=index,
                channel=channel,
                option="" if low else repr(float(operating.channels[channel] * abs(sensor.gain))),
            )
            for index, sensor, channel in _sensors(rig, (*RESPONSES, "force"))
            if amplitudes.get(channel, 0.0) > 0.0
        )

    return placements


def _with_clip(rig: Rig, placement: Placement, values: Mapping[str, float]) -> Rig:
    return with_value(rig, ("sensors", placement.index, "clip"), float(placement.option) * exp(-values["depth"]))


def _with_lsb(rig: Rig, placement: Placement, values: Mapping[str, float]) -> Rig:
    sensor = rig.sensors[placement.index]
    bits = 20
    changed = sensor.model_copy(update={"bits": bits, "range": values["lsb"] * 2.0 ** (bits - 1)})
    return with_value(rig, ("sensors", placement.index), changed)


def _hum_placements(rig: Rig, operating: OperatingRange) -> tuple[Placement, ...]:
    found = []
    for index, sensor, channel in _sensors(rig, (*RESPONSES, "force")):
        for hz in MAINS_HZ:
            # A sensor has one line.
            if sensor.hum_amplitude == 0.0 or sensor.hum_hz == hz:
                label = channel if hz == MAINS_HZ[0] else f"{channel} at {hz:g} Hz"
                scale = {"amplitude": 0.01 * operating.channels_low.get(channel, 1.0)}
                point = rig.sensor_point(sensor)
                found.append(Placement(label, scale, point, index=index, option=f"{hz:g}", channel=channel))
    return tuple(found)


def _with_hum(rig: Rig, placement: Placement, values: Mapping[str, float]) -> Rig:
    sensor = rig.sensors[placement.index]
    changes = {"hum_amplitude": sensor.hum_amplitude + values["amplitude"], "hum_hz": float(placement.option)}
    return with_value(rig, ("sensors", placement.index), sensor.model_copy(update=changes))


def _high_pass(sensor: SensorSection, values: Mapping[str, float]) -> float:
    return values["f_h"]


def _low_pass(sensor: SensorSection, values: Mapping[str, float]) -> float:
    return 1.0 / (2.0 * pi * values["time_constant"])


def _low_pass_report(values: Mapping[str, float]) -> Reported:
    tau = values["time_constant"]
    return {"low_pass_hz": (1.0 / (2.0 * pi * tau) if tau > 0.0 else float("inf"), "Hz")}


def _chain_effect(
    name: str, equation: str, parameter: EffectParameter, key: str,
    value: Callable[[SensorSection, Mapping[str, float]], float | None],
    scale: Callable[[OperatingRange, str], float], report: Callable[[Mapping[str, float]], Reported] | None = None,
    equivalents: Mapping[str, str] | None = None,
) -> Effect:  # fmt: skip
    return Effect(
        name=name,
        place="response_sensor",
        equation=equation,
        reference=MEASUREMENT,
        keys=f"sensors.{key}",
        parameters=(parameter,),
        placements=_per_channel((*RESPONSES, "force"), parameter.name, scale),
        change=_set(key, value),
        report=report,
        equivalents=equivalents or {},
    )


def placed(effect: Effect, placement: Placement, rig: Rig) -> Place:
    """Place of a candidate: an effect of a channel belongs to the force sensor where that channel is the force."""
    if effect.place == "response_sensor" and placement.index >= 0:
        return "force_sensor" if rig.sensors[placement.index].quantity == "force" else "response_sensor"
    return effect.place


SENSOR_EFFECTS: tuple[Effect, ...] = (
    Effect(
        name="force_gain", place="force_sensor", equation="F (1 + g)", reference=MEASUREMENT, keys="sensors.gain",
        parameters=(EffectParameter("g", "1", signed=True),),
        placements=_per_channel(("force",), "g", lambda operating, channel: 0.02),
        change=_set("gain", lambda sensor, values: sensor.gain * (1.0 + values["g"])),
        equivalents={"response_gain": "a random test with the voltage as reference"},
    ),
    Effect(
        name="force_cell_mass", place="force_sensor", equation="F + m a", keys="sensors.mass_kg",
        reference="Ewins, Modal Testing (2000), mass cancellation",
        parameters=(EffectParameter("m", "kg", signed=True),),
        placements=_force_mass_placements,
        change=_set("mass_kg", lambda sensor, values: sensor.mass_kg + values["m"]),
    ),
    Effect(
        name="response_gain", place="response_sensor", equation="y (1 + g)", reference=MEASUREMENT,
        keys="sensors.gain", parameters=(EffectParameter("g", "1", signed=True),),
        placements=_per_channel(RESPONSES, "g", lambda operating, channel: 0.02),
        change=_set("gain", lambda sensor, values: sensor.gain * (1.0 + values["g"])),
        equivalents={"force_gain": "a random test with the voltage as reference"},
    ),
    Effect(
        name="transverse_sensitivity", place="response_sensor", equation="y + s y⊥ (y of another point)",
        reference="ISO 16063-31 (2009)", keys="sensors.transverse",
        parameters=(EffectParameter("s", "1", signed=True),),
        placements=_transverse_placements, change=_with_transverse,
        equivalents={"response_gain": "several modes in a random test"},
    ),
    Effect(
        name="sensor_mass", place="response_sensor", equation="m a at the sensor's point", keys="sensors.mass_kg",
        reference=MEASUREMENT, parameters=(EffectParameter("m", "kg", signed=True),),
        placements=_mass_placements,
        change=_set("mass_kg", lambda sensor, values: sensor.mass_kg + values["m"]),
        equivalents={"added_mass": "a test with the sensor taken off"},
    ),
    _chain_effect(
        "channel_skew", "e^{−iωτ}", EffectParameter("tau", "s", signed=True), "delay_s",
        lambda sensor, values: sensor.delay_s + values["tau"], lambda operating, channel: 0.005 / operating.omega,
        equivalents={"low_pass": "a random test"},
    ),
    _chain_effect(
        "low_pass", "1/(1 + iω/ω_c), strength 1/ω_c", EffectParameter("time_constant", "s"), "low_pass_hz",
        _low_pass, lambda operating, channel: 0.005 / operating.omega, _low_pass_report,
        {"channel_skew": "a random test"},
    ),
    _chain_effect(
        "charge_high_pass", "iω/(iω + 2πf_h)", EffectParameter("f_h", "Hz", grid=(0.3, 1.0, 3.0)), "high_pass_hz",
        _high_pass, lambda operating, channel: 0.005 * operating.omega / (2.0 * pi),
    ),
    Effect(
        name="clipping", place="response_sensor", equation="clip(y, ±A e^{−depth}), A = largest amplitude of the model",
        reference=MEASUREMENT, keys="sensors.clip",
        parameters=(EffectParameter("depth", "1", grid=(0.5, 1.0, 2.0, 4.0)),),
        placements=_limit_placements(low=False), change=_with_clip,
    ),
    Effect(
        name="quantisation", place="response_sensor", equation="LSB · round(y/LSB)",
        reference="Widrow and Kollár, Quantization Noise (2008)", keys="sensors.bits, sensors.range",
        parameters=(EffectParameter("lsb", "channel", grid=(0.3, 1.0, 1.8)),),
        placements=_limit_placements(low=True), change=_with_lsb,
    ),
    Effect(
        name="mains_hum", place="response_sensor", equation="y + A cos(2π 50 t), or 60", reference=MEASUREMENT,
        keys="sensors.hum_amplitude, sensors.hum_hz", parameters=(EffectParameter("amplitude", "channel"),),
        placements=_hum_placements, change=_with_hum,
    ),
    Effect(
        name="clock_error", place="response_sensor", equation="f (1 + e)", keys="clock_error",
        reference="IEEE Std 1057 (2017)",
        parameters=(EffectParameter("e", "1", signed=True),),
        placements=lambda rig, operating: (Placement("", {"e": 1e-3}),),
        change=lambda rig, placement, values: with_value(
            rig, ("clock_error",), value_at(rig, ("clock_error",)) + values["e"]
        ),
        equivalents={"youngs_modulus": "a reference clock"},
    ),
)  # fmt: skip
