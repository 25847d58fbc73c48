"""Check of every channel and of the loop at low level, before a real test.

A converter is listened to in silence, then driven with noise whose peaks stay below one hundredth of the drive's limit.
What is measured is compared, port by port, in volts, with what the rig's model makes of the same drive: as frequency
responses to the drive, by the same estimator, so that its errors are the same on both sides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_plant.check.check_record import DRIVE_SHARE, CheckRecord, drive_band, record_check
from nmt_plant.check.check_result import ChannelFigures, CheckFinding, CheckResult, ModeFigures
from nmt_plant.check.model_fit import ModelFit, MovedModes, fit_model, scan_modes
from nmt_plant.devices.hardware_rig import HardwareRig
from nmt_plant.specimen import Specimen
from nmt_rig.linear_description import linear_description
from nmt_signals.channel_faults.mains_lines import MAINS_HZ, mains_line
from nmt_signals.frequency_responses import averaged_spectra

_SEGMENT = 2.0  # s, of the frequency responses
_MOST_NOISE, _MOST_MAINS, _MOST_OFFSET = 1e-4, 5e-4, 0.05  # of the range: rms, amplitude, mean
_RAIL = 0.8  # of the range, from which an offset is that of a sensor without supply
_CONNECTED = 0.3  # coherence below which a channel does not follow the drive
_CLEAR = 0.9  # coherence of the lines that are compared
_GAIN_TOLERANCE = 0.15  # relative, next to four times the sensitivity's own uncertainty
_FOLLOWS = 0.3  # correlation of drive and monitor, from which a delay is believed
_SAME_CHANNEL = 0.08  # mean logarithmic difference of responses that are the same
_SAME_MOVED = 0.3  # the same where frequencies do not agree: modes beyond the band are not moved
_FREQUENCY_TOLERANCE = 0.03
_MODEL_ERROR = 0.02  # relative, of a line of a response
_SURE = 5.0  # standard deviations
_MOST_DAMPING, _MOST_FREQUENCY, _MOST_TURN = 0.01, 1e-4, 5.0  # errors of a test: of δ̃, of ω̃; degrees of a shape
_HEADROOM = 0.9  # of the range that planned levels may reach
_CLOCK_PPM = 200.0  # a short record knows no better
_MOST_LOST = 0.02  # of the blocks; fewer are marked and cost a window each

_REMEDIES = {
    "overload": "take a larger range or a less sensitive sensor; look for a broken sensor or amplifier",
    "short": "look for a short circuit, a muted or wrong port",
    "icp": "switch the sensor's supply on, look for an open cable, set coupling: ac",
    "offset": "zero the conditioner or set coupling: ac",
    "mains": "look for a ground loop, insulate the sensor, connect the shield on one side",
    "noise": "look at cable and connector, at the conditioner's gain, and for vibration from elsewhere",
    "rate": "set sample_rate_hz to the converter's true rate, look for a wrong external clock",
    "no_drive": "switch the amplifier on, look at its gain, at the emergency stop and at the stinger",
    "open": "look at its cable, at the sensor's mounting and at the channel map",
    "losses": "give real-time priority ('./nmt doctor'), larger blocks, and end other programs",
    "delay": "let output and input share one clock; look for lost samples",
    "resonance": "look at the clamping and at the rig file, or make a linear test ('./nmt linear') and give its file",
    "sensitivity": "compare sensitivity_v with the calibration sheet, and the conditioner's gain",
    "force_response": "exchange their cables, or their ports in the channel map",
    "permuted": "exchange their cables, or their ports in the channel map",
    "late": "look at filters and delays of its conditioner and converter; sample all inputs together",
    "sign": "turn the sensor round, or write its sensitivity_v with a minus",
    "headroom": "take a larger range, a less sensitive sensor, or lower levels",
}
"""What fixes a finding, by its name."""


def expected_response(device: HardwareRig, put_out: FloatArray) -> FloatArray:
    """Volts at the ports, (inputs, samples), of the rig's model for the output."""
    model = Specimen(device.rig, device.section, bits=32, noise=0.0)
    ports = np.zeros((model.outputs, put_out.size))
    ports[0] = put_out / device.section.output.amplifier_gain
    parts = np.array_split(ports, max(1, put_out.size // 2000), axis=1)
    return np.concatenate([model.respond(part) for part in parts], axis=1)


@dataclass(frozen=True, eq=False)
class _Responses:
    """Frequency responses to the drive: lines (Hz), H of each channel, coherence."""

    lines: FloatArray
    values: Any
    coherence: FloatArray


def _responses(drive: FloatArray, measured: FloatArray, rate: float, band: tuple[float, float]) -> _Responses:
    length = min(round(_SEGMENT * rate), drive.size // 4)
    inside = (1.1 * band[0], 0.9 * band[1])
    values, coherence = [], []
    lines: FloatArray = np.empty(0)
    for row in measured:
        spectra = averaged_spectra({"drive": drive, "channel": row}, rate, length, inside, overlap=0.5)
        lines = spectra.frequency_hz
        power, own = spectra.cross("drive", "drive").real, spectra.cross("channel", "channel").real
        cross = spectra.cross("channel", "drive")
        values.append(cross / power)
        coherence.append(np.where(own > 0.0, np.abs(cross) ** 2 / np.maximum(power * own, 1e-300), 0.0))
    return _Responses(lines, np.array(values), np.array(coherence))


class _Evaluation:
    """The findings of a record, one question a method."""

    def __init__(self, device: HardwareRig, record: CheckRecord, levels: Sequence[float], linear_hz: float) -> None:
        self.device, self.record, self.levels = device, record, levels
        self.rate = device.sample_rate
        self.inputs = device.section.inputs
        self.names = [entry.channel for entry in self.inputs]
        self.ranges = np.array([entry.range_v for entry in self.inputs])
        self.quantities = {sensor.channel: sensor.quantity for sensor in device.sensors}
        self.points = {sensor.channel: sensor.point for sensor in device.sensors}
        rig = device.rig
        # Of the exciter that drives: the others' show nothing.
        self.monitors = {
            rig.sensor_channel(each) for each in rig.sensors if each.quantity == "voltage" and each.exciter in (None, 1)
        }
        self.findings: list[CheckFinding] = []
        self.condemned: set[int] = set()  # what is wrong with them hides everything else
        band = drive_band(device)
        self.is_driven = record.put_out.size >= 8 * round(_SEGMENT * self.rate) // 2 and bool(record.put_out.any())
        self.lags = self._lags()
        if self.is_driven:
            self.found = _responses(self._reference(), record.driven, self.rate, band)
            self.expected = _responses(record.put_out, expected_response(device, record.put_out), self.rate, band)
            self.coherence = np.median(self.found.coherence, axis=1)
        else:
            self.coherence = np.zeros(len(self.names))
        self.gains = np.full(len(self.names), math.nan)
        self.expected_hz = linear_hz or linear_description(device.rig).frequency_hz
        self.target_hz = linear_description(device.rig).frequency_hz
        self.model: MovedModes | None = None
        self.moved: FloatArray = np.empty(0)
        self.at_rest: ComplexArray = np.empty(0, dtype=np.complex128)
        self.as_planned: ComplexArray = self.at_rest
        self.fit: ModelFit | None = None
        self.noise, self.mains, self.offset = self._floor()

    def add(self, name: str, rows: Sequence[int], sentence: str, remedy: str = "") -> None:
        channels = tuple(self.names[row] for row in rows)
        self.findings.append(CheckFinding(name, channels, sentence, remedy or _REMEDIES[name]))

    def _floor(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Noise (V rms), mains (V) and mean (V) of every channel in silence."""
        silent = self.record.silent
        offset = silent.mean(axis=1)
        lines = np.zeros((len(MAINS_HZ), len(self.names)))
        for row, frequency in enumerate(MAINS_HZ):
            line = mains_line(None, silent, self.rate, 0, frequency)
            if line is not None:
                lines[row] = np.maximum(line.amplitudes, 0.0)
        noise = np.sqrt(np.maximum(silent.var(axis=1) - 0.5 * np.sum(lines**2, axis=0), 0.0))
        return noise, lines.max(axis=0), offset

    # -- questions -----------------------------------------------------------------------------------------------

    def ask(self) -> None:
        if self.record.ended:
            late = self.record.ended.startswith("output:")
            remedy = "end other programs, give real-time priority ('./nmt doctor')" if late else "look at the limit"
            self.add("losses" if late else "limit", (), f"the drive was taken to zero: {self.record.ended}", remedy)
        for row in range(len(self.names)):
            self._ask_port(row)
        self._ask_bench()
        if self._drives_another:
            return  # nothing is as the model expects it
        if self.is_driven and not any(finding.name == "no_drive" for finding in self.findings):
            self._move_modes()
            self._ask_gains()
            self._ask_resonance()
            self._ask_lateness()
            self._ask_headroom()

    @property
    def _drives_another(self) -> bool:
        """Whether, of several exciters, the monitor of the one that drives does not show its drive."""
        own = {row for row, name in enumerate(self.names) if name in self.monitors}
        return len(self.device.rig.all_exciters) > 1 and bool(own) and own <= self.condemned

    def _ask_port(self, row: int) -> None:
        """What one port shows without a model."""
        name, full = self.names[row], self.ranges[row]
        peak = max(float(np.abs(self.record.silent[row]).max()), float(np.abs(self.record.driven[row]).max()))
        if peak >= 0.999 * full:
            self.condemned.add(row)
            self.add("overload", [row], f"{name} reaches the end of its range ({full:g} V)")
            return
        if np.ptp(self.record.silent[row]) == 0.0 and np.ptp(self.record.driven[row]) == 0.0:
            self.condemned.add(row)
            self.add("short", [row], f"{name} does not move by a bit")
            return
        if abs(self.offset[row]) >= _RAIL * full:
            self.condemned.add(row)
            self.add(
                "icp",
                [row],
                f"{name} sits at {self.offset[row]:.3g} V of {full:g} V, as an ICP input without supply does",
            )
            return
        if abs(self.offset[row]) > _MOST_OFFSET * full:
            self.add("offset", [row], f"{name} has a mean of {self.offset[row]:.3g} V")
        if self.mains[row] > _MOST_MAINS * full:
            self.add("mains", [row], f"{name} carries {self.mains[row]:.3g} V of the mains' frequency")
        if self.noise[row] > _MOST_NOISE * full:
            self.add("noise", [row], f"{name} has {self.noise[row]:.3g} V rms of noise")

    def _ask_bench(self) -> None:
        """What concerns all channels: response at all, delay, clock, losses."""
        figures = self.device.figures
        if abs(figures.clock_ppm) > _CLOCK_PPM:
            self.add("rate", (), f"the converter's clock is {figures.clock_ppm:+.0f} ppm off this computer's")
        others = [
            row
            for row, name in enumerate(self.names)
            if self.quantities[name] is not Quantity.VOLTAGE and row not in self.condemned
        ]
        deaf = [row for row in others if self.coherence[row] < _CONNECTED]
        if self.is_driven and others and len(deaf) == len(others):
            self.add("no_drive", (), "no channel responds to the drive: the loop does not close")
            return
        monitors = [row for row, name in enumerate(self.names) if name in self.monitors]
        for row in [
            *deaf,
            *(row for row in monitors if self.coherence[row] < _CONNECTED and row not in self.condemned),
        ]:
            if not self.is_driven:
                continue
            self.condemned.add(row)
            if any(each.name in ("noise", "mains") and self.names[row] in each.channels for each in self.findings):
                continue  # what hides the response has been named
            self.add(
                "open", [row], f"{self.names[row]} does not follow the drive (coherence {self.coherence[row]:.2f})"
            )
        if self.is_driven and self._delay_moves:
            self.add("delay", (), f"the delay from drive to monitor moves by {max(self.lags) - min(self.lags)} samples")
        if self.record.lost_blocks > _MOST_LOST * (self.record.put_out.size / self.device.block_samples):
            self.add("losses", (), f"{self.record.lost_blocks} blocks had lost samples")

    @property
    def _delay_moves(self) -> bool:
        return bool(self.lags) and max(self.lags) - min(self.lags) > 1

    def _lags(self) -> list[int]:
        """Delay from drive to monitor in every second, samples; empty without a monitor that follows the drive."""
        row, drive = self._monitor_row, self.record.put_out
        if row is None or not self.is_driven:
            return []
        size = round(self.rate)
        lags = []
        for start in range(0, drive.size - size + 1, size):
            sent, seen = drive[start : start + size], self.record.driven[row, start : start + size]
            seen = seen - seen.mean()
            product = np.fft.irfft(np.fft.rfft(seen, 2 * size) * np.conj(np.fft.rfft(sent, 2 * size)))
            reach = size // 10
            around = np.abs(np.concatenate([product[-reach:], product[:reach]]))
            if around.max() < _FOLLOWS * np.linalg.norm(sent) * np.linalg.norm(seen):
                return []
            lags.append(int(np.argmax(around)) - reach)
        return lags

    @property
    def _monitor_row(self) -> int | None:
        return next((row for row, name in enumerate(self.names) if name in self.monitors), None)

    def _reference(self) -> FloatArray:
        """The drive to which responses are referred: as seen at the monitor where its delay moves, V."""
        row = self._monitor_row
        if row is None or not self._delay_moves:
            return self.record.put_out
        return np.asarray(self.record.driven[row] / self.inputs[row].sensitivity_v)

    def _move_modes(self) -> None:
        """Let the model's modes lie where the responses have them, whatever gains and phases are."""
        try:
            self.model = MovedModes(self.device.rig, self.found.lines, self.names)
        except ValueError:
            return  # as it is
        one = np.ones(self.model.frequencies.size)
        self.at_rest = self.model(one, one)
        usable = np.array([self._is_usable(row) for row in range(len(self.names))])
        clear = (self.found.coherence > _CLEAR) & (self.expected.coherence > _CLEAR) & usable[:, None]
        measured, expected = np.abs(self.found.values), np.abs(self.expected.values)
        self.moved = scan_modes(self.model, measured, clear, self.at_rest, expected)
        self.as_planned = self.expected.values
        values = self.as_planned * self.model(self.moved, one) / self.at_rest
        self.expected = _Responses(self.expected.lines, values, self.expected.coherence)

    def _fit(self, rows: Sequence[int]) -> None:
        """Modes, gains and delays, by channels that are not taken for others."""
        usable = [row for row in rows if self._is_usable(row)]
        if self.model is None or not usable:
            return
        coherence = np.clip(self.found.coherence, 1e-6, 1.0 - 1e-9)
        averages = 2.0 * self.record.put_out.size / (_SEGMENT * self.rate)
        std = np.hypot(np.sqrt((1.0 - coherence) / (2.0 * coherence * averages)), _MODEL_ERROR)
        std[(self.found.coherence <= _CLEAR) | (self.expected.coherence <= _CLEAR)] = np.inf
        arguments = self.found.values, std, self.as_planned, self.at_rest, self.moved, usable, self.found.lines
        self.fit = fit_model(self.model, *arguments)

    def _ask_resonance(self) -> None:
        """Whether each of the model's modes lies where the model has it."""
        off = [
            f"mode {mode.number} lies at {mode.frequency_hz:.4g} Hz (±{mode.frequency_std:.1g}), "
            f"{100.0 * (mode.frequency_hz / mode.model_hz - 1.0):+.1f} % from the {mode.model_hz:.4g} Hz of the model"
            for mode in self.mode_figures
            if abs(mode.frequency_hz - mode.model_hz)
            > max(_FREQUENCY_TOLERANCE * mode.model_hz, _SURE * mode.frequency_std)
        ]
        if off:
            self.add("resonance", (), "; ".join(off))

    def _ask_lateness(self) -> None:
        """Channels that come later or earlier than the others."""
        fit = self.fit
        if fit is None:
            return
        for row, delay, std in zip(fit.rows, fit.delay, fit.delay_std, strict=True):
            damping, frequency = self.test_errors(row, 1.0, delay)
            turn = 360.0 * self.target_hz * delay
            broken = abs(damping) > _MOST_DAMPING or abs(frequency) > _MOST_FREQUENCY or abs(turn) > _MOST_TURN
            if broken and abs(delay) > _SURE * std:
                self.add(
                    "late",
                    [row],
                    f"{self.names[row]} comes {1e3 * abs(delay):.4g} ms (±{1e3 * std:.1g}) "
                    f"{'after' if delay > 0 else 'before'} the others, {abs(turn):.2g}° at {self.target_hz:.4g} Hz: "
                    f"the test would give {_error_words(damping, frequency)}",
                )

    def test_errors(self, row: int, gain: float, delay: float) -> tuple[float, float]:
        """Relative errors of damping ratio and frequency that a channel's gain and delay (s) make in a test."""
        linear = linear_description(self.device.rig)
        omega, target = linear.frequencies_rad_s[linear.target_mode], linear.target_mode
        quantity, point = self.quantities[self.names[row]], self.points[self.names[row]]
        factor = gain * np.exp(-1j * omega * delay)
        shape = linear.shape_matrix.astype(np.complex128)
        at = shape[:, target].copy()
        is_shape = quantity.topic == self.device.rig.extraction.quantity
        if is_shape and point in linear.points:
            at[linear.points.index(point)] *= factor
        turned = quantity is Quantity.FORCE or (is_shape and point == linear.drive_point)
        angle = float(np.angle(factor * np.sign(gain))) if turned else 0.0  # held by the loop, and missing in truth
        power = abs(gain) / max(math.cos(angle), 1e-6) if turned else 1.0
        amplitude = float(np.linalg.norm(np.linalg.pinv(shape) @ at))
        frequency = math.tan(-angle if quantity is Quantity.FORCE else angle)
        return power / max(amplitude, 1e-12) ** 2 - 1.0, linear.damping_ratios[target] * frequency

    def _is_usable(self, row: int) -> bool:
        quantity = self.quantities[self.names[row]]
        return row not in self.condemned and quantity is not Quantity.VOLTAGE and self.coherence[row] > _CONNECTED

    def _ratio(self, row: int, other: int) -> FloatArray:
        """Logarithm of found over expected, of the lines that are clear in both."""
        expected = np.abs(self.expected.values[other])
        clear = (self.found.coherence[row] > _CLEAR) & (self.expected.coherence[other] > _CLEAR) & (expected > 0.0)
        return np.asarray(np.log(np.maximum(np.abs(self.found.values[row])[clear], 1e-300) / expected[clear]))

    def _misfit(self, row: int, other: int, any_gain: bool = False) -> float:
        ratio = self._ratio(row, other)
        if ratio.size < 10:
            return math.inf
        if any_gain:
            ratio = ratio - np.median(ratio)
        return float(np.mean(np.minimum(np.abs(ratio), 3.0)))

    def _ask_gains(self) -> None:
        """Sign, exchanged channels, sensitivity."""
        rows = [row for row in range(len(self.names)) if row not in self.condemned and self.coherence[row] > _CONNECTED]
        for row in rows:
            ratio = self._ratio(row, row)
            if ratio.size >= 10:
                self.gains[row] = math.exp(float(np.median(ratio)))
        exchanged = self._exchanged(rows)
        self._fit([row for row in rows if row not in exchanged])
        for row in rows:
            if row in exchanged:
                continue
            self._ask_sensitivity(row, self.gains[row])
            if self._turn(row) < -0.5:
                self.add("sign", [row], f"{self.names[row]} has the wrong sign")

    def _ask_sensitivity(self, row: int, gain: float) -> None:
        tolerance = _GAIN_TOLERANCE + 4.0 * (self.inputs[row].uncertainty or 0.0)
        if abs(math.log(gain)) > math.log1p(tolerance):
            self.add(
                "sensitivity",
                [row],
                f"{self.names[row]} measures {gain:.3g} times what the model expects: the test would give "
                f"{_error_words(*self.test_errors(row, gain, 0.0))}",
            )

    def _turn(self, row: int) -> float:
        """Mean cosine of the phase between found and expected, of a fitted channel the sign of its gain."""
        if self.fit is not None and row in self.fit.rows:
            return float(np.sign(self.fit.gain[self.fit.rows.index(row)]))
        chosen = (self.found.coherence[row] > _CLEAR) & (self.expected.coherence[row] > _CLEAR)
        product = self.found.values[row] * np.conj(self.expected.values[row])
        return float(np.mean((product / np.maximum(np.abs(product), 1e-300)).real[chosen])) if chosen.any() else 0.0

    def _exchanged(self, rows: Sequence[int]) -> set[int]:
        """Channels whose response is that expected of another, whose own is not right either.

        The other may show nothing of its sensor; and one of both may have a wrong sensitivity besides.
        """
        own = {row: self._misfit(row, row) for row in rows}
        wrong = [row for row in rows if own[row] > _SAME_CHANNEL]
        mute = [row for row in self.condemned if self.quantities[self.names[row]] is not Quantity.VOLTAGE]
        pairs = [(one, other) for index, one in enumerate(wrong) for other in wrong[index + 1 :]]
        costs = {pair: self._cross_cost(*pair, own) for pair in pairs}
        costs |= {(one, other): self._one_sided_cost(one, other, own) for one in wrong for other in mute}
        found: set[int] = set()
        for (one, other), cost in sorted(costs.items(), key=lambda item: item[1]):
            if not math.isfinite(cost) or one in found or other in found:
                continue
            found |= {one, other}
            first, second = sorted((one, other))
            names = self.names[first], self.names[second]
            with_force = Quantity.FORCE in (self.quantities[names[0]], self.quantities[names[1]])
            self.add(
                "force_response" if with_force else "permuted",
                [first, second],
                f"{names[0]} and {names[1]} are exchanged",
            )
            for row, as_row in ((one, other), (other, one)):
                if row not in self.condemned:
                    self._ask_sensitivity(row, math.exp(float(np.median(self._ratio(row, as_row)))))
        return found

    @property
    def _same(self) -> float:
        is_moved = self.moved.size > 0 and bool(np.any(np.abs(self.moved - 1.0) > 0.005))
        return _SAME_MOVED if is_moved else _SAME_CHANNEL

    def _cross_cost(self, one: int, other: int, own: Mapping[int, float]) -> float:
        """Misfit of two channels each taken for the other; infinite where they are not exchanged."""
        crossed = [self._misfit(one, other), self._misfit(other, one)]
        if max(crossed) <= self._same and max(crossed) <= 0.5 * max(own[one], own[other]):
            return max(crossed)
        shapes = [self._misfit(one, other, True), self._misfit(other, one, True)]
        kept = [self._misfit(row, row, True) for row in (one, other)]
        if max(shapes) <= self._same and min(kept) > 2.0 * max(shapes) and min(crossed) <= self._same:
            return max(crossed)
        return math.inf

    def _one_sided_cost(self, one: int, other: int, own: Mapping[int, float]) -> float:
        """Misfit of a channel taken for another that shows nothing; infinite where it is not that other's."""
        crossed = self._misfit(one, other)
        return crossed if crossed <= min(self._same, 0.5 * own[one]) else math.inf

    def headroom(self, row: int) -> float:
        """Share of its range that a channel reaches at the highest planned level, by linear reckoning."""
        if not self.is_driven or row in self.condemned or self.coherence[row] < _CONNECTED or not self.levels:
            return math.nan
        values = self.found.values[row]
        clear = self.found.coherence[row] > 0.5
        if not clear.any():
            return math.nan
        lines = self.found.lines
        near = clear & (np.abs(lines / (self.target_ratio * self.expected_hz) - 1.0) < 0.15)
        chosen = near if near.any() else clear
        return float(np.abs(values[chosen]).max() * max(self.levels) / self.ranges[row])

    def turn_of(self, row: int) -> float:
        """Negative where a channel has the wrong sign."""
        return self._turn(row) if self.is_driven and math.isfinite(self.gains[row]) else 1.0

    def fitted_figures(self, row: int) -> tuple[float, ...]:
        """`ChannelFigures` from ``gain_std`` on; NaN where the channel was not fitted."""
        fit = self.fit
        if fit is None or row not in fit.rows:
            return (math.nan,) * 5
        at = fit.rows.index(row)
        delay = float(fit.delay[at])
        errors = self.test_errors(row, float(fit.gain[at]), delay)
        return float(fit.gain_std[at]), delay, float(fit.delay_std[at]), *errors

    @property
    def mode_figures(self) -> tuple[ModeFigures, ...]:
        """The model's modes; empty where nothing was fitted."""
        fit, model = self.fit, self.model
        if fit is None or model is None:
            return ()
        figures = np.column_stack(
            (
                fit.frequency * fit.mode_hz, fit.frequency_std * fit.mode_hz, fit.mode_hz,
                fit.damping, fit.damping_std, model.damping,
            )
        )  # fmt: skip
        rows = zip(model.numbers, figures, strict=True)
        return tuple(ModeFigures(int(number) + 1, *map(float, row)) for number, row in rows)

    @property
    def target_ratio(self) -> float:
        """Frequency of the target mode over the model's."""
        if self.fit is None:
            return 1.0
        return float(self.fit.frequency[np.argmin(np.abs(self.fit.mode_hz - self.target_hz))])

    def _ask_headroom(self) -> None:
        for row, name in enumerate(self.names):
            share = self.headroom(row)
            if share > _HEADROOM:
                self.add(
                    "headroom", [row], f"{name} would reach {100 * share:.0f} % of its range at {max(self.levels):g} V"
                )


def _error_words(damping: float, frequency: float) -> str:
    """Errors of a test for people."""
    return f"δ̃ wrong by {100.0 * damping:+.2g} % and ω̃ by {1e6 * frequency:+.3g} ppm"


def evaluate_check(
    device: HardwareRig, record: CheckRecord, levels: Sequence[float] = (), linear_hz: float = 0.0
) -> CheckResult:
    """Findings and figures of a record.

    Args:
        device: that made it.
        record: of `record_check`.
        levels: planned drive amplitudes, V; empty = headroom is not asked for.
        linear_hz: frequency of the target mode from a linear test, Hz; 0 = the model's.
    """
    asked = _Evaluation(device, record, levels, linear_hz)
    asked.ask()
    figures = device.figures
    channels = tuple(
        ChannelFigures(
            entry.channel,
            str(entry.port),
            asked.quantities[entry.channel].unit,
            float(asked.noise[row]),
            float(asked.noise[row] / abs(entry.sensitivity_v)),
            float(asked.mains[row]),
            float(asked.offset[row]),
            float(asked.coherence[row]),
            float(math.copysign(asked.gains[row], asked.turn_of(row))),
            asked.headroom(row),
            *asked.fitted_figures(row),
        )
        for row, entry in enumerate(asked.inputs)
    )
    return CheckResult(
        tuple(asked.findings),
        channels,
        float(np.abs(record.put_out).max(initial=0.0)),
        DRIVE_SHARE * (device.rig.limits.voltage_v or 0.0),
        figures.delay,
        figures.round_trip,
        figures.stated,
        figures.clock_ppm,
        asked.target_ratio * asked.target_hz,
        asked.expected_hz,
        record.lost_blocks,
        asked.mode_figures,
    )


def check(device: HardwareRig, levels: Sequence[float] = (), linear_hz: float = 0.0) -> CheckResult:
    """Record and evaluate; the device is started, ends at zero and stays open.

    Raises:
        DeviceFault: the device failed.
    """
    return evaluate_check(device, record_check(device), levels, linear_hz)
