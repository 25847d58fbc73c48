"""The sidecar of an import: what the columns of someone else's data are.

Keys beyond those that a measurement needs (``linear``, ``extraction``, ``oscillator``, ``loop`` and the like) are
written by ``./nmt export``, so that an exported run can be imported and extracted again without loss.
"""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from nmt_core.errors import BenchError
from nmt_core.files.validation_sentence import validation_sentence
from nmt_core.files.yaml_document import YamlDocument, read_document
from nmt_core.kinds import KINDS
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import TestKind
from nmt_record.exchange.unit_table import measured_quantity, si_unit

Positive = Annotated[float, Field(gt=0)]
PointNumber = Annotated[int, Field(ge=0, le=99_999_999)]
LONGEST_DELAY_S = 10.0
Span = Annotated[list[float], Field(min_length=2, max_length=2)]
QuantityName = Literal[
    "force", "displacement", "velocity", "acceleration", "voltage", "current",
    "torque", "angle", "angular_velocity", "angular_acceleration", "strain",
]  # fmt: skip


class TableKind(StrEnum):
    """What a table of someone else's is."""

    BACKBONE = "backbone"
    FRF = "frf"


if TYPE_CHECKING:
    SignalKind = str
    TableKindName = str
else:
    SignalKind = Literal[tuple(number.label for number in KINDS)]
    TableKindName = Literal[tuple(kind.value for kind in TableKind)]
EXPORTED_KINDS = (TestKind.SELF_EXCITED, TestKind.SECONDARY_RESONANCE)
"""Kinds whose windows mean something only with the lock events that an export has next to them."""
_ELEMENTS = r"^(samples|channels|interleaved [1-9]\d*|bytes (u?int(8|16|32)|float(32|64))( big)?)$"
HELD_KINDS = (TestKind.RECORD, TestKind.STEPPED_SINE)
"""Kinds of which the sidecar may say whether force or motion was given."""
STEADY_KINDS = (TestKind.PHASE_RESONANCE, TestKind.STEPPED_SINE)


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class ChannelSection(_Section):
    """One column of the data.

    Attributes:
        column: name (CSV header, NPZ array, first ID line of a UFF dataset) or number from 1.
        quantity: measured quantity; an angle or a strain replaces a displacement, a torque a force.
        unit: unit of the values after ``scale``.
        point: measurement point; left out where it belongs to none (drive voltage).
        scale: factor before the unit applies: N per count; left out = as the file says, else 1.
        sign: −1 for a reversed sensor; left out = as the file says, else 1.
        delay_s: delay of the channel, s; it is removed.
        wrap: range after which numbers begin again (65536, 360); 0 = never; left out = whole turns of an angle are
            found.
        sign_bit: sign bit of whole numbers in sign and magnitude (15 of 16 bits); 0 = none.
        zero_step: keep = the load stepped, not the zero; left out = asked.
        no_value: code of no value; left out = the usual codes.
        force_factor: of a current that serves as a force: N per A (N·m per A with ``force_unit``).
        force_factor_std: its relative standard uncertainty; left out = 3 %.
        force_unit: N, or N*m where the current turns.
        name: name in the bag; left out = letter of the quantity and point, such as a2.
        gain_std: relative standard uncertainty of its calibration; left out = 1 %.
        phase_std_deg: standard uncertainty of a constant phase, degrees; left out = 0.2.
        delay_std_s: standard uncertainty of its delay, s; left out = 10 µs; of a voltage against all sensors, 100 µs.
    """

    column: str | int
    quantity: QuantityName
    unit: str
    point: PointNumber = 0
    scale: float = 1.0
    sign: Literal[1, -1] | None = None
    delay_s: Annotated[float, Field(ge=-LONGEST_DELAY_S, le=LONGEST_DELAY_S)] = 0.0
    wrap: Annotated[float, Field(ge=0)] | None = None
    sign_bit: Annotated[int, Field(ge=0, le=52)] | None = None
    zero_step: Literal["keep"] | None = None
    no_value: float | None = None
    force_factor: Positive | None = None
    force_factor_std: Annotated[float, Field(ge=0, lt=1)] | None = None
    force_unit: Literal["N", "N*m"] = "N"
    name: Annotated[str, Field(min_length=1, max_length=60)] | None = None
    gain_std: Annotated[float, Field(ge=0)] | None = None
    phase_std_deg: Annotated[float, Field(ge=0)] | None = None
    delay_std_s: Annotated[float, Field(ge=0)] | None = None

    @property
    def recorded(self) -> Quantity:
        """The quantity that the column holds."""
        return measured_quantity(self.quantity)

    @property
    def measures(self) -> Quantity:
        """The quantity that it serves as: a current with a force factor is a force."""
        return Quantity.FORCE if self.force_factor is not None else self.recorded

    @property
    def si_unit(self) -> str:
        """Unit in the bag."""
        return si_unit(self.quantity) if self.force_factor is None else self.force_unit

    @property
    def channel(self) -> str:
        """Name of the channel in the bag."""
        if self.name is not None:
            return self.name
        return self.measures.letter + (str(self.point) if self.point else "")


class SignalSection(_Section):
    """A stretch of the data in which one thing was done.

    Attributes:
        kind: what was done.
        start: begin, s on the file's time axis (negative before a trigger).
        stop: end, s.
        level: amplitude that was asked for; in ``level_unit``.
        level_unit: V, N, m, m/s or m/s^2; N*m, rad, rad/s or rad/s^2.
        window: begin and end of the steady part, s.
        locked: false = a level that did not lock, without a window.
        reason: why it did not lock.
        frequency_hz: excitation or start frequency; left out = from the force.
        periods: whole periods in the window; left out = all.
        band_hz: random: lower and upper edge.
        rate_hz_s: sweep: Hz/s, sign = direction.
        frequency_end_hz: sweep: last frequency.
        switch_off: ring_down: time of the switch-off, s; left out = ``start``.
        index: number of the level in the plan, from 0; left out = counted.
        lock_time: when the lock was confirmed, s.
        phase_error: rad, at the lock.
        held: record, stepped_sine: response = the motion of the drive point was imposed; left out = from motion and
            model.
    """

    kind: SignalKind
    start: float
    stop: float
    level: float | None = None
    level_unit: Literal["V", "N", "m", "m/s", "m/s^2", "N*m", "rad", "rad/s", "rad/s^2"] = "V"
    window: Span | None = None
    locked: bool = True
    reason: str = ""
    frequency_hz: Positive | None = None
    periods: Annotated[int, Field(ge=0)] = 0
    band_hz: Span | None = None
    rate_hz_s: float | None = None
    frequency_end_hz: Positive | None = None
    switch_off: float | None = None
    index: Annotated[int, Field(ge=0)] | None = None
    lock_time: float | None = None
    phase_error: float | None = None
    held: Literal["force", "response"] | None = None

    @property
    def test(self) -> TestKind:
        """Kind of test."""
        return TestKind[self.kind.upper()]


class TableSection(_Section):
    """A table that someone else has already reduced.

    Attributes:
        kind: backbone (frequency_hz, amplitude, [damping_ratio, loss_factor or quality_factor], […_std]) or frf
            (frequency_hz, real and imag or magnitude and phase, [level], […_std]).
        file: left out = the sidecar's file.
        columns: column of each name, if called otherwise.
        unit: of the amplitude (m, g, m*sqrt(kg) …) or of the response per force (m/s^2/N), base acceleration (g/g) or
            drive (m/s^2/V), or alone (m/s) with ``level`` and ``level_unit``; left out = as the file says.
        units: of other columns: ``{frequency_hz: rad/s, damping_ratio: '%', phase: deg}``; ``{magnitude: dB}`` re 1
            ``unit``.
        order: periods of the response a turn, for tables over rpm; left out = 1, asked if a heading names another.
        point: point of the response.
        drive_point: point of the force.
        level: of the whole table; of a frequency response the held amplitude (peak).
        level_unit: unit of the level (N, g, m/s^2, mm, V).
        held: held quantity: force, response, base or voltage; left out = by the unit of the level.
        direction: up or down, the way the frequency was stepped.
        noise: relative standard uncertainty of every line, %.
        per: column that every line is divided by; ``unit`` is that of the quotient, or of the response if the column is
            in N.
        scale: factor before the unit applies; −1 for a reversed sensor.
        conjugate: the phase is that of exp(−iωt), or a lag.
        phase_shift_deg: what is added to the phase, after ``conjugate``.
        axis: x, y or z (rx, ry, rz) of a universal file with several directions at a point.
        turned: points of a universal file whose responses are reversed; left out = by its directions.
        amplitudes: whether amplitudes and level are peak, rms or peak-to-peak values.
        ordinate: magnitude, of a universal file whose frequency responses are real numbers.
        name: for reports.
    """

    kind: TableKindName
    unit: str = ""
    file: str | None = None
    columns: dict[str, str | int] = {}
    units: dict[str, str] = {}
    order: Positive | None = None
    point: PointNumber = 0
    drive_point: PointNumber = 0
    level: float | None = None
    level_unit: str = ""
    held: Literal["force", "response", "base", "voltage"] | None = None
    direction: Literal["up", "down"] | None = None
    noise: Positive | None = None
    per: str | int | None = None
    scale: float = 1.0
    conjugate: bool = False
    phase_shift_deg: float = 0.0
    axis: Literal["x", "y", "z", "rx", "ry", "rz"] | None = None
    turned: list[Annotated[int, Field(ge=0)]] | None = None
    amplitudes: Literal["peak", "rms", "peak_to_peak"] = "peak"
    ordinate: Literal["magnitude"] | None = None
    name: str = ""


class RepeatabilitySection(_Section):
    """By how much repeats of the test differ, one standard deviation; for the diagnosis.

    Attributes:
        frequency: of a resonance or a decay, relative.
        damping: of a damping ratio, relative.
        amplitude: of fundamentals and frequency responses, relative.
        phase_deg: of their phases.
    """

    frequency: Annotated[float, Field(ge=0, lt=1)] = 0.0
    damping: Annotated[float, Field(ge=0, lt=1)] = 0.0
    amplitude: Annotated[float, Field(ge=0, lt=1)] = 0.0
    phase_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0


class Sidecar(_Section):
    """All of it.

    Attributes:
        rig: name or path of a rig file, or any name.
        file: the data.
        sample_rate: Hz; left out if there is a time column.
        time: time column, if not called time or t; of a bag the field that counts time.
        time_unit: its unit; d = days, as in spreadsheets and MATLAB.
        clock: valid clock in a contradiction: sample_rate, header (of the file, or stamps of a bag), column, or log (of
            a bag).
        stretch: number from 1 of a stretch of a bag that paused or jumped; left out = all.
        elements: meaning of unnamed array elements in a bag: samples, channels, interleaved 2, or bytes int16
            (little-endian; bytes int16 big); left out = as the file says.
        channels: the columns to import.
        segments: what was done when, and tables of others.
        linear: linear.json with the linear modes.
        extraction: settings of the extraction.
        oscillator: table of the excitation's phase block by block.
        loop: table of the loop's state block by block.
        levels: table of recorded levels; left out = from the segments.
        locks: table of recorded lock events; left out = from the segments.
        plan: what the run was asked for, as in run.json.
        exciter_points: points of several exciters, in the order of their voltages.
        first_sample: index of the first sample of the file.
        repeatability: by how much repeats of the tests differ.
        run_id: of the run it was exported from.
        note: anything.
    """

    file: str
    rig: str | None = None
    sample_rate: Positive | None = None
    time: str | int | None = None
    time_unit: Literal["s", "ms", "us", "ns", "min", "h", "d"] = "s"
    clock: Literal["sample_rate", "header", "column", "log"] | None = None
    stretch: Annotated[int, Field(ge=1)] | Literal["all"] = "all"
    elements: Annotated[str, Field(pattern=_ELEMENTS)] | None = None
    channels: list[ChannelSection] = []
    segments: list[SignalSection | TableSection] = []
    linear: str | None = None
    extraction: dict[str, Any] | None = None
    oscillator: str | None = None
    loop: str | None = None
    levels: str | None = None
    locks: str | None = None
    plan: dict[str, Any] | None = None
    exciter_points: list[PointNumber] | None = None
    first_sample: Annotated[int, Field(ge=0)] = 0
    repeatability: RepeatabilitySection | None = None
    run_id: str | None = None
    note: str = ""

    @model_validator(mode="after")
    def _has_something(self) -> Sidecar:
        if not self.channels and not self.tables:
            raise ValueError("has neither channels nor a backbone or frf table; say what the columns of the file are")
        return self

    @property
    def tables(self) -> list[TableSection]:
        """Tables of others."""
        return [section for section in self.segments if isinstance(section, TableSection)]

    @property
    def signals(self) -> list[SignalSection]:
        """Stretches of the data."""
        return [section for section in self.segments if isinstance(section, SignalSection)]


def read_sidecar(path: Path) -> tuple[Sidecar, YamlDocument]:
    """Read and check a sidecar.

    Returns:
        The sidecar, and the document with the line of every key.

    Raises:
        BenchError: not there, not YAML, or the first thing that is wrong in it, with its line.
    """
    document = read_document(path, "sidecar", "file and channels")
    return sidecar_of(document), document


def sidecar_of(document: YamlDocument) -> Sidecar:
    """The sidecar that a document is.

    Raises:
        BenchError: the first thing that is wrong in it, with its line.
    """
    values = _normalised(document.values)
    try:
        sidecar = Sidecar.model_validate(values)
    except ValidationError as failure:
        every = failure.errors(include_url=False)
        errors = [error for error in every if _concerns(error, values)] or every
        remedies = {"unit": "for example unit: N; without it the numbers mean nothing"}
        sentence = validation_sentence(errors, document, Sidecar, "the sidecar", values=values, remedies=remedies)
        raise BenchError(sentence) from failure
    return sidecar


def _normalised(values: dict[str, Any]) -> dict[str, Any]:
    """A file that is one table may say so at the top; ``kind: observables`` may name its kind as ``table``."""
    result = dict(values)
    if result.get("kind") in (*TableKind, "observables") and "segments" not in result:
        own = {
            key: result.pop(key)
            for key in list(result)
            if key in (*TableSection.model_fields, "table") and key != "file"
        }
        result["segments"] = [own]
    segments = result.get("segments")
    if isinstance(segments, list):
        result["segments"] = [_table_named(item) for item in segments]
    return result


def _table_named(item: Any) -> Any:
    if isinstance(item, dict) and item.get("kind") == "observables" and item.get("table") in tuple(TableKind):
        return {**{key: value for key, value in item.items() if key != "table"}, "kind": item["table"]}
    return item


def _concerns(error: ErrorDetails, values: dict[str, Any]) -> bool:
    """Whether an error is one of the kind of segment that was meant, not of the other alternative."""
    location = error["loc"]
    if len(location) < 3 or location[0] != "segments":
        return True
    try:
        kind = values["segments"][location[1]]["kind"]
    except (KeyError, TypeError, IndexError):
        return location[2] == "SignalSection"
    return location[2] == ("TableSection" if kind in tuple(TableKind) else "SignalSection")


def check_sidecar(sidecar: Sidecar, document: YamlDocument) -> None:
    """Contradictions within a sidecar that do not need the data to be seen.

    Raises:
        BenchError: the first one, with its line.
    """
    _check_channels(sidecar, document)
    reached, last = -math.inf, ""
    order = sorted(
        ((i, s) for i, s in enumerate(sidecar.segments) if isinstance(s, SignalSection)), key=lambda pair: pair[1].start
    )
    if order and not sidecar.channels:
        raise BenchError(
            f"{document.place(('segments',))}: there are segments of time data but no channels; list the columns."
        )
    for number, segment in order:
        place = document.place(("segments", number))
        name = f"segment {number + 1} ({segment.kind})"
        if segment.stop <= segment.start:
            raise BenchError(f"{place}: {name} ends at {segment.stop:g} s, not after its start at {segment.start:g} s.")
        if segment.start < reached:
            raise BenchError(
                f"{place}: {name} starts at {segment.start:g} s, before {last} ends at {reached:g} s; segments must "
                f"not overlap."
            )
        _check_segment(segment, name, place)
        if segment.test in EXPORTED_KINDS and sidecar.locks is None:
            raise BenchError(
                f"{place}: {name} needs the lock events of './nmt export' (locks: locks.csv), which say what each "
                "window is; import a recording of another bench as kind: record."
            )
        reached, last = segment.stop, name


def _check_channels(sidecar: Sidecar, document: YamlDocument) -> None:
    columns: dict[str | int, int] = {}
    meanings: dict[tuple[Quantity, int], int] = {}
    names: dict[str, int] = {}
    for number, channel in enumerate(sidecar.channels):
        place = document.place(("channels", number))
        if channel.scale == 0.0:
            raise BenchError(f"{place}: the scale of column {channel.column} is zero; give the factor or leave it out.")
        if channel.force_factor is not None and channel.quantity != "current":
            raise BenchError(
                f"{place}: force_factor makes a force of a current, but column {channel.column} measures "
                f"{channel.quantity}; leave it out."
            )
        if channel.force_factor is None and {"force_factor_std", "force_unit"} & channel.model_fields_set:
            raise BenchError(f"{place}: column {channel.column} has no force_factor; give it, in N or N*m per A.")
        if isinstance(channel.column, int) and channel.column < 1:
            raise BenchError(f"{place}: columns are counted from 1, got {channel.column}.")
        if channel.column in columns:
            raise BenchError(
                f"{place}: column {channel.column} is given twice (channels {columns[channel.column] + 1} and "
                f"{number + 1})."
            )
        meaning = (channel.measures, channel.point)
        if meaning in meanings and meaning != (Quantity.VOLTAGE, 0):
            raise BenchError(
                f"{place}: channels {meanings[meaning] + 1} and {number + 1} both measure {channel.quantity} at point "
                f"{channel.point}; give each its own point."
            )
        if channel.channel in names:
            raise BenchError(f"{place}: two channels are named {channel.channel}; rename one.")
        columns[channel.column] = meanings[meaning] = names[channel.channel] = number


def _check_segment(segment: SignalSection, name: str, place: str) -> None:
    needs_window = segment.test in STEADY_KINDS
    if needs_window and segment.locked and segment.window is None:
        raise BenchError(
            f"{place}: {name} needs window: [begin, end], its steady part in s, or locked: false if it never became "
            f"steady."
        )
    if segment.window is not None:
        begin, end = segment.window
        if not end > begin:
            raise BenchError(f"{place}: the window of {name} ends at {end:g} s, not after its begin at {begin:g} s.")
        if begin < segment.start or end > segment.stop:
            raise BenchError(
                f"{place}: the window {begin:g} to {end:g} s of {name} is not within its {segment.start:g} to "
                f"{segment.stop:g} s."
            )
    if (
        segment.test is TestKind.RING_DOWN
        and segment.switch_off is not None
        and not segment.start <= segment.switch_off < segment.stop
    ):
        raise BenchError(f"{place}: switch_off {segment.switch_off:g} s of {name} is not within the segment.")
    if segment.band_hz is not None and not 0.0 <= segment.band_hz[0] < segment.band_hz[1]:
        raise BenchError(f"{place}: band_hz of {name} must be two ascending frequencies, got {segment.band_hz}.")
    if segment.held is not None and segment.test not in HELD_KINDS:
        raise BenchError(
            f"{place}: held says what was given in a record or a stepped_sine, but {name} is neither; leave held out."
        )
    if segment.level is not None and segment.level < 0.0:
        raise BenchError(f"{place}: the level of {name} must not be negative, got {segment.level:g}.")
