"""Texts drawn at random: headings, units, separators, clocks, counts, words, feet; each with what is true of it.

``python tests/record/generated_texts.py 300`` reads as many and prints how many were right, asked about and refused.
"""

from __future__ import annotations

import datetime
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_core.errors import BenchError
from nmt_record.exchange.imports.imported_run import read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

# Spellings of a unit, its factor to SI, and how a sidecar answers.
UNITS = {
    "acceleration": ((("m/s^2", "m/s²", "m/s2", "m s-2", "m/sec^2"), 1.0, "m/s^2"), (("g", "G"), 9.80665, "g"),
                     (("mm/s²",), 1e-3, "mm/s^2"), (("mg",), 9.80665e-3, "mg")),
    "velocity": ((("m/s", "m s-1"), 1.0, "m/s"), (("mm/s", "mm/sec"), 1e-3, "mm/s"), (("ips", "in/s"), 0.0254, "in/s")),
    "displacement": ((("mm",), 1e-3, "mm"), (("µm", "um"), 1e-6, "um"), (("mil", "mils"), 25.4e-6, "mil")),
    "force": ((("N",), 1.0, "N"), (("kN",), 1e3, "kN"), (("lbf", "lbs"), 4.4482216152605, "lbf")),
    "angle": ((("rad",), 1.0, "rad"), (("deg", "°"), np.pi / 180.0, "deg")),
    "torque": ((("N·m", "N*m", "Nm", "N m"), 1.0, "N*m"), (("lbf-in",), 0.1129848290276167, "lbf*in")),
    "current": ((("A",), 1.0, "A"), (("mA",), 1e-3, "mA")),
}  # fmt: skip
NAMES = {
    "acceleration": ("Acc", "Accel Z", "acceleration", "Beschleunigung", "Sensor 1", "CH2", "a1", "top"),
    "velocity": ("Laser", "Velocity", "vibrometer", "Geschwindigkeit", "CH1", "v2"),
    "displacement": ("Laser", "Gap", "Weg", "disp", "x1", "LVDT"),
    "force": ("Force", "Kraft", "load cell", "F", "Hammer", "f1"),
    "angle": ("angle", "joint 3", "phi", "encoder"),
    "torque": ("torque", "Moment", "effort"),
    "current": ("Shaker current", "Strom", "i"),
}  # fmt: skip
SIZES = {"acceleration": 20.0, "velocity": 0.05, "displacement": 1e-4, "force": 30.0, "angle": 0.5, "torque": 2.0,
         "current": 3.0}  # fmt: skip
RATES = (50.0, 200.0, 1000.0, 1024.0, 2000.0, 10_000.0, 25_600.0)
CLOCKS = (
    "s", "ms", "us", "min", "h", "matlab", "excel", "iso", "half day", "colon", "two columns", "sec nsec", "newest",
    "wrap", "epoch", "none", "heading", "bare", "midnight",
)  # fmt: skip
HEADS = ("square", "round", "slash", "comma", "word", "row", "end", "none")
BEGIN = datetime.datetime(2025, 3, 4, 11, 59, 58, 500000)


@dataclass
class Column:
    """A channel as it stands in the file.

    Attributes:
        name: heading without unit.
        quantity, unit, spelling: truth and how it is written; ``spelling`` empty = nowhere.
        values: in the unit.
        step: of the last digit, in the unit.
        cells: as written.
    """

    name: str
    quantity: str
    unit: str
    factor: float
    spelling: str
    values: np.ndarray
    step: float
    cells: list[str]


@dataclass
class Text:
    """A file and its truth."""

    path: Path
    rate: float
    clock: str
    columns: list[Column]
    drawn: dict[str, Any] = field(default_factory=dict)


def times(clock: str, t: np.ndarray, rng: np.random.Generator) -> tuple[list[tuple[str, str]], list[list[str]]]:
    """Names and units of the columns of the clock, and their cells."""
    stamps = [BEGIN + datetime.timedelta(microseconds=round(1e6 * moment)) for moment in t]
    if clock in ("s", "newest"):
        return [(str(rng.choice(["Time", "t", "Zeit", "time"])), "s")], [[f"{moment:.7f}" for moment in t]]
    if clock in ("ms", "us", "min", "h"):
        factor = {"ms": 1e3, "us": 1e6, "min": 1 / 60, "h": 1 / 3600}[clock]
        return [("Time", clock)], [[f"{factor * moment:.{4 if factor > 1 else 12}f}" for moment in t]]
    if clock in ("matlab", "excel"):
        zero, name = (739580.4371527, "Time") if clock == "matlab" else (45987.5, "Date")
        return [(name, "")], [[f"{zero + moment / 86400:.11f}" for moment in t]]
    if clock in ("iso", "half day", "colon", "midnight"):
        if clock == "midnight":
            stamps = [moment + datetime.timedelta(hours=12) for moment in stamps]
        form = {"iso": "%Y-%m-%dT%H:%M:%S.%f", "half day": "%m/%d/%Y %I:%M:%S.%f %p", "colon": "%H:%M:%S:%f",
                "midnight": "%H:%M:%S.%f"}[clock]  # fmt: skip
        return [("Timestamp", "")], [[moment.strftime(form) for moment in stamps]]
    if clock == "two columns":
        return [("Date", ""), ("Time", "")], [
            [f"{moment:%Y-%m-%d}" for moment in stamps],
            [f"{moment:%H:%M:%S.%f}" for moment in stamps],
        ]
    if clock == "sec nsec":
        nanoseconds = [round(1e9 * moment) + 123_456_789 for moment in t]
        return [("stamp.sec", ""), ("stamp.nanosec", "")], [[str(1764064800 + n // 10**9) for n in nanoseconds],
                                                            [str(n % 10**9) for n in nanoseconds]]  # fmt: skip
    if clock == "wrap":
        half = round(5e5 * float(t[-1]))
        return [("micros", "")], [[str((2**32 - half + round(1e6 * moment)) % 2**32) for moment in t]]
    if clock == "epoch":
        return [("time", "")], [[f"{1_764_064_800.25 + moment:.6f}" for moment in t]]
    if clock == "bare":
        return [("t", "")], [[f"{moment:.7f}" for moment in t]]
    return [], []


def heading(name: str, unit: str, style: str) -> str:
    """A heading with its unit."""
    if not unit or style in ("row", "none"):
        return name
    forms = {
        "square": "{} [{}]",
        "round": "{} ({})",
        "slash": "{} / {}",
        "comma": "{}, {}",
        "word": "{} in {}",
        "end": "{} [{}]",
    }
    return forms[style].format(name, unit)


def channel(count: int, taken: set[str], known: bool, rng: np.random.Generator) -> Column:
    quantity = str(rng.choice(list(UNITS)))
    spellings, factor, unit = UNITS[quantity][int(rng.integers(len(UNITS[quantity])))]
    spelling = str(rng.choice(spellings)) if known else ""
    name = str(rng.choice(NAMES[quantity]))
    while name in taken:
        name += " b"
    taken.add(name)
    wave = np.exp(-float(rng.choice([0.0, 2.0])) * np.arange(count) / count) * np.sin(
        float(rng.uniform(0.2, 0.6)) * np.arange(count) + float(rng.uniform(0.0, 6.0))
    )
    size = SIZES[quantity] / factor
    decimals = max(1, int(rng.integers(3, 6)) - round(np.log10(size)))
    values = np.round(size * wave, decimals)
    return Column(
        name, quantity, unit, factor, spelling, values, 10.0**-decimals, [f"{value:.{decimals}f}" for value in values]
    )


def made(seed: int, folder: Path) -> Text:
    """The file of a seed."""
    rng = np.random.default_rng(seed)
    clock, head = str(rng.choice(CLOCKS)), str(rng.choice(HEADS))
    rate, count = float(rng.choice(RATES)), int(rng.integers(300, 1500))
    if clock in ("matlab", "excel") and rate > 2000.0:
        rate = 1000.0
    if head == "none" and clock in ("min", "h"):
        clock = "s"  # a time in minutes that says so nowhere looks like seconds of a fast recording
    t = np.arange(count) / rate
    taken: set[str] = set()
    columns = [channel(count, taken, head != "none", rng) for _ in range(int(rng.integers(1, 4)))]
    labels, cells = times(clock, t, rng)
    heads = [heading(name, unit, head) for name, unit in labels] + [heading(c.name, c.spelling, head) for c in columns]
    units = [unit for _, unit in labels] + [c.spelling for c in columns]
    cells += [c.cells for c in columns]
    delimiter, comma = ((",", False), (";", False), (";", True), ("\t", False))[int(rng.integers(4))]
    drawn: dict[str, Any] = {"head": head, "delimiter": delimiter, "comma": comma}
    if rng.random() < 0.25:
        place = int(rng.integers(len(labels), len(cells) + 1))
        cells.insert(place, [str(rng.choice(["ok", "base link", "valid"])) for _ in range(count)])
        heads.insert(place, "status")
        units.insert(place, "")
        drawn["words"] = True
    if rng.random() < 0.2:
        cells.insert(0, [str(k) for k in range(count)])
        heads.insert(0, "Sample")
        units.insert(0, "")
        drawn["counter"] = True
    if comma:
        cells = [
            [cell.replace(".", ",") if cell.count(".") == 1 and ":" not in cell else cell for cell in column]
            for column in cells
        ]
    elif rng.random() < 0.15 and delimiter != "\t":
        cells = [[_grouped(cell) for cell in column] for column in cells]
        drawn["grouped"] = True
    quoted = drawn.get("grouped") or rng.random() < 0.2 or any(delimiter in cell for cell in heads)
    drawn["quoted"] = quoted
    write = (lambda row: delimiter.join(f'"{cell}"' for cell in row)) if quoted else delimiter.join
    lines = [write(row) for row in zip(*cells, strict=True)]
    if clock == "newest":
        lines.reverse()
    above = []
    if clock == "heading":
        above.append(f"# Sample rate: {rate:g} Hz" if rng.random() < 0.5 else f"Sampling rate (Hz){delimiter}{rate:g}")
    if rng.random() < 0.3:
        above = ["# Logger XY-7", *above]
    above.append(write(heads))
    if head == "row":
        above.append(write(units))
    if rng.random() < 0.15:
        lines += ["", delimiter.join(["Max", *["1.0"] * (len(heads) - 1)])]
        drawn["foot"] = True
    path = folder / f"text{seed}.{rng.choice(['csv', 'txt'])}"
    ending = str(rng.choice(["\n", "\r\n"]))
    path.write_bytes(ending.join([*above, *lines, ""]).encode(str(rng.choice(["utf-8", "utf-8-sig", "cp1252"]))))
    return Text(path, rate, clock, columns, drawn)


def _grouped(cell: str) -> str:
    """A number with thousands in groups."""
    try:
        digits, point, part = cell.partition(".")
        return (
            f"{int(digits):,}{point}{part}"
            if len(digits.lstrip("-")) > 3 and (point or abs(int(digits)) >= 10**6)
            else cell
        )
    except ValueError:
        return cell


def answered(text: str, file: Text) -> tuple[dict[str, Any], list[str]]:
    """The proposal with its questions answered by whoever made the recording, and what was asked."""
    values, asked = yaml.safe_load(text), []
    answers = {"sample_rate": file.rate, "clock": "column",
               "time_unit": {"matlab": "d", "excel": "d", "wrap": "us", "epoch": "s"}.get(file.clock, "s")}  # fmt: skip
    if file.clock in ("ms", "us", "min", "h") and file.drawn["head"] == "none":
        answers["time_unit"] = file.clock
    for key, answer in answers.items():
        if values.get(key) == "?":
            asked.append(key)
            values[key] = answer
    kept = []
    for number, entry in enumerate(values["channels"]):
        drawn = truth(entry["column"], file)
        if drawn is None:
            if "?" in entry.values():
                asked.append("a column that is none")
                continue
            raise AssertionError(f"{file.path.name}: {entry} is proposed")
        for key, answer in (("quantity", drawn.quantity), ("unit", drawn.unit), ("scale", 1.0), ("sign", 1)):
            if entry.get(key) == "?":
                asked.append(key)
                entry[key] = answer
        entry["point"] = number + 1
        kept.append(entry)
    values["channels"] = kept
    for segment in values["segments"]:
        for key in ("start", "stop"):
            if segment.get(key) == "?":
                asked.append(key)
                segment[key] = 0.0 if key == "start" else (file.columns[0].values.size - 1) / file.rate
    return values, asked


def truth(column: str | int, file: Text) -> Column | None:
    """The channel that a proposal names."""
    if isinstance(column, int):
        return None
    found = [
        drawn
        for drawn in file.columns
        if column in (drawn.name, heading(drawn.name, drawn.spelling, file.drawn["head"]))
    ]
    return found[0] if found else None


def judged(file: Text) -> tuple[str, list[str]]:
    """``right``, ``asked`` with the questions, or ``refused`` with the sentence.

    Raises:
        AssertionError: a value is wrong, or an answered proposal is refused.
    """
    where = f"{file.path.name} ({file.clock}, {file.drawn})"
    try:
        (text,) = sidecar_templates(file.path)
    except BenchError as error:
        if f"{file.path.stem}.yaml" in str(error):
            raise AssertionError(f"{where}: the proposal is refused: {error}") from error
        return "refused", [str(error)]
    values, asked = answered(text, file)
    sidecar = file.path.with_name(f"{file.path.stem}.yaml")
    sidecar.write_text(yaml.safe_dump(values, allow_unicode=True), encoding="utf-8")
    try:
        run = read_import(sidecar)
    except BenchError as error:
        if not asked:
            raise AssertionError(f"{where}: the proposal is refused: {error}") from error
        return "refused", [str(error)]
    assert abs(run.sample_rate / file.rate - 1.0) < max(3e-5, 3.0 * run.clock_std), f"{where}: {run.sample_rate} Hz"
    assert run.samples == file.columns[0].values.size, where
    assert len(run.channels) == len(file.columns), f"{where}: {[found.name for found in run.channels]}"
    for found in run.channels:
        column = truth(found.section.column, file)
        assert column is not None, where
        assert found.section.quantity == column.quantity, f"{where}: {column.name} is {found.section.quantity}"
        away = np.abs(found.data - column.values * column.factor).max()
        assert away <= 0.6 * column.step * column.factor, f"{where}: {column.name} is off by {away}"
    return ("asked" if asked else "right"), asked


def main() -> None:
    results: Counter[str] = Counter()
    questions: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(int(sys.argv[1])):
            file = made(seed, Path(folder))
            try:
                result, answers = judged(file)
            except AssertionError as error:
                result, answers = "WRONG", [str(error)[:300]]
            except Exception as error:
                result, answers = (
                    "ERROR",
                    [f"{file.path.name} {file.clock} {file.drawn}: {type(error).__name__} {error}"[:300]],
                )
            results[result] += 1
            if result in ("asked",):
                questions.update(set(answers))
            elif result != "right":
                print(result, seed, file.clock, file.drawn, answers)
    print(dict(results), dict(questions))


if __name__ == "__main__":
    main()
