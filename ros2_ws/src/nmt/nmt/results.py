"""Results of the bench's commands as frozen objects: tables, arrays, plots, files.

Every class has all of ``rows``, ``to_dataframe``, ``to_xarray``, ``export``, ``plot``, ``figures``. ``to_dataframe``
needs pandas and ``to_xarray`` needs xarray, which ``pip install '.[analysis]'`` in a clone brings; all else works
without them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nmt.dataset_files import write_dataset
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import writing
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import COMPLEX, MEASURED, QUANTITIES, ModalPoint
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import PointStatus
from nmt_report.html_page import PageColumn, Row, Table, part
from nmt_report.quantity_format import significant, uncertain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nmt_extract.curves.response_curve import ResponseCurve
    from nmt_extract.curves.swept_response import FrequencyResponseTable
    from nmt_record.exchange.reduced.frf_table import FrequencyResponseRecord


_TAU = 2.0 * math.pi
_REPEATABILITY = "_repeatability"
_WITH_STD = tuple(name + suffix for name in MEASURED for suffix in ("", "_std"))


@dataclass(frozen=True, repr=False)
class Results:
    """What every results folder has.

    Attributes:
        folder: where it is.
    """

    folder: Path

    def rows(self) -> list[dict[str, Any]]:
        """The main table, one mapping a row; units stand in the names of the columns.

        Raises:
            NotImplementedError: a class of results without a table.
        """
        raise NotImplementedError

    def to_dataframe(self) -> Any:
        """The main table as a ``pandas.DataFrame``.

            Raises:
                BenchError: pandas is not installed.

        Examples:
            >>> table = nmt.open("out/demo").to_dataframe()
            >>> table["level"].tolist()
            [0.1, 0.6]
            >>> nmt.open("out/reference").to_dataframe().shape[0]
            2
        """
        return _pandas().DataFrame(self.rows(), columns=list(self.columns) or None)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the main table, those of a table without rows, too, where they are fixed."""
        return tuple(next(iter(self.rows()), ()))

    def to_xarray(self) -> Any:
        """Everything as one ``xarray.Dataset``.

        Raises:
            NotImplementedError: a class of results without one.
        """
        raise NotImplementedError

    def plot(self, **options: Any) -> Axes:
        """What the results show best, on axes of matplotlib.

        Raises:
            NotImplementedError: a class of results without a plot.
        """
        raise NotImplementedError

    def to_netcdf(self, path: Path | str) -> Path:
        """Write :meth:`to_xarray` as NetCDF 3; a complex variable becomes two, ``NAME_real`` and ``NAME_imag``.

        Args:
            path: the file, whatever its ending.

        Returns:
            The path.

        Raises:
            BenchError: xarray is not installed, or the file cannot be written.
        """
        return write_dataset(self.to_xarray(), Path(path), ".nc")

    def export(self, path: Path | str) -> Path:
        """Write the results to a file; its ending chooses what and how.

            Args:
                path: ``.csv``: the rows of :meth:`to_dataframe`; ``.nc``, ``.npz``, ``.h5`` or ``.mat``: the arrays of
                    :meth:`to_xarray`.

            Returns:
                The path.

            Raises:
                BenchError: no such format, pandas or xarray is not installed, or the file cannot be written.

        Examples:
            >>> nmt.open("out/demo").export("out/demo.npz").name
            'demo.npz'
            >>> nmt.open("out/demo").export("out/d.docx")
            Traceback (most recent call last):
            nmt_core.errors.BenchError: d.docx: arrays are written as .nc, .npz, .h5, .mat; choose ...
        """
        target = Path(path)
        if target.suffix != ".csv":
            return write_dataset(self.to_xarray(), target)
        with writing(target):
            self.to_dataframe().to_csv(target, index=False)
        return target

    def figures(self, folder: Path | str, **options: Any) -> list[Any]:
        """Write the figures of the report to a folder, made if it is not there.

        Options as of :func:`nmt_report.write_figures`.

        Raises:
            BenchError: the folder has no report.
        """
        from nmt_report.figure_files import write_figures

        Path(folder).mkdir(parents=True, exist_ok=True)
        return list(write_figures(self.folder, folder, **options))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.folder)!r}: {self._summary})"

    @property
    def _summary(self) -> str:
        """What is there, in a few words."""
        return _counted(len(self.rows()), "row")

    def _repr_html_(self) -> str:
        """What a notebook shows: the main table."""
        rows = self.rows()
        names = list(rows[0]) if rows else []
        head = [
            PageColumn(name, kind="" if rows and isinstance(rows[0][name], int | float) else "text") for name in names
        ]
        body = [Row([_cell(row[name]) for name in names]) for row in rows]
        return str(part("table", Table(head, body, heading=f"{type(self).__name__}: {self.folder}")))


def _counted(number: int, name: str) -> str:
    return f"{number} {name}{'' if number == 1 else 's'}"


def _cell(value: Any) -> str:
    return significant(value, 6) if isinstance(value, float) else str(value)


def _pandas() -> Any:
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise BenchError(
            "Tables need pandas, which is not installed; in a clone: pip install '.[analysis]'."
        ) from error
    return pandas


def _xarray() -> Any:
    try:
        import xarray
    except ModuleNotFoundError as error:
        raise BenchError(
            "Datasets need xarray, which is not installed; in a clone: pip install '.[analysis]'."
        ) from error
    return xarray


def _axes(axes: Axes | None) -> Axes:
    """Axes to draw on; new ones of matplotlib's current figure manager if there are none."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    return pyplot.subplots()[1]


_LABELS = {"level": "level"} | {quantity.name: quantity.axis for quantity in QUANTITIES if quantity.axis}


@dataclass(frozen=True, repr=False)
class RunResults(Results):
    """A run or an extraction: one modal point a level.

    ``<name>_std`` is the total standard uncertainty by the budget (``uncertainty.json``) where there is one, as in the
    report; ``<name>_repeatability`` is what the window shows of itself. Without a budget both are the repeatability.

    Attributes:
        points: of all levels, in the order of the test; those that gave no values say why.
        inputs: what the extraction worked with.
        repeatability: number of the level -> name of each quantity with a budget -> its repeatability.
    """

    points: tuple[ModalPoint, ...] = ()
    inputs: Mapping[str, Any] = field(default_factory=dict)
    repeatability: Mapping[int, Mapping[str, float]] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> RunResults:
        """Read ``modal.json``, and ``uncertainty.json`` where there is one.

        Raises:
            BenchError: damaged.
        """
        from nmt_extract.judgement.uncertainty_budget import read_totals
        from nmt_extract.modal.table import read_json

        points, inputs = read_json(folder / "modal.json")
        budget = folder / "uncertainty.json"
        totals = read_totals(budget) if budget.is_file() else {}
        repeatability = {
            point.level_index: {name: getattr(point, f"{name}_std") for name in totals[point.level_index]}
            for point in points
            if point.level_index in totals
        }
        stated = []
        for point in points:
            changes: dict[str, Any] = {f"{name}_std": it for name, it in totals.get(point.level_index, {}).items()}
            stated.append(replace(point, **changes))
        return cls(folder, tuple(stated), inputs, repeatability)

    @property
    def _summary(self) -> str:
        return f"{len(self.good_points)} of {_counted(len(self.points), 'level')} with values"

    @property
    def good_points(self) -> tuple[ModalPoint, ...]:
        """The points with values."""
        return tuple(point for point in self.points if point.status == PointStatus.OK)

    @property
    def linear(self) -> LinearDescription | None:
        """What the extraction knew of the linear system; None where nothing is recorded."""
        values = self.inputs.get("linear")
        return LinearDescription.from_mapping(dict(values)) if isinstance(values, Mapping) else None

    @property
    def response_curves(self) -> tuple[ResponseCurve, ...]:
        """Response curves in the order in which they were measured; none of another kind of test."""
        from nmt_extract.curves.response_curve import is_of_curve, response_curves

        return response_curves(self.points) if is_of_curve(self.points) else ()

    def values(self, name: str) -> FloatArray:
        """One property over the levels with values, shape ``(levels,)``.

            Args:
                name: field of :class:`nmt_core.messages.modal_point.ModalPoint`, ``<name>_std`` or
                    ``<name>_repeatability``.

            Raises:
                BenchError: no such property exists.

        Examples:
            >>> run = nmt.open("out/demo")
            >>> run.values("frequency_hz").round(3)
            array([22.193, 21.12 ])
            >>> run.values("loudness")
            Traceback (most recent call last):
            nmt_core.errors.BenchError: A modal point has no property 'loudness'; it has frequency_hz, omega_rad_s, ...
        """
        plain = name.removesuffix(_REPEATABILITY)
        if plain != name and plain in MEASURED:
            return np.array([self._repeatability(point, plain) for point in self.good_points])
        if not hasattr(ModalPoint, name) or name in COMPLEX:
            raise BenchError(f"A modal point has no property '{name}'; it has {', '.join(MEASURED)}.")
        return np.array([float(getattr(point, name)) for point in self.good_points])

    def _repeatability(self, point: ModalPoint, name: str) -> float:
        return float(self.repeatability.get(point.level_index, {}).get(name, getattr(point, f"{name}_std")))

    @property
    def _with_budget(self) -> tuple[str, ...]:
        """Quantities whose standard uncertainty is the total of a budget."""
        return tuple(name for name in MEASURED if any(name in table for table in self.repeatability.values()))

    def rows(self) -> list[dict[str, Any]]:
        """One row a level: status, level, every measured property with its standard uncertainty and repeatability."""
        return [
            {
                "level_index": point.level_index,
                "status": point.status.name,
                "reason": point.reason,
                "level": point.level,
                "level_unit": point.level_unit,
                **{name: getattr(point, name) for name in _WITH_STD},
                **{name + _REPEATABILITY: self._repeatability(point, name) for name in self._with_budget},
            }
            for point in self.points
        ]

    def to_xarray(self) -> Any:
        """All of it as an ``xarray.Dataset``: properties over ``level``; harmonics over level, order and point.

            Levels without values are left out.

            Raises:
                BenchError: xarray is not installed, or no level has values.

        Examples:
            >>> dataset = nmt.open("out/demo").to_xarray()
            >>> dict(dataset.sizes)
            {'level': 2, 'order': 8, 'point': 2, 'mode': 2}
            >>> round(abs(dataset.force_harmonics.sel(level=0.6, order=1)).item(), 3)
            1.145
        """
        library = _xarray()
        points = self.good_points
        if not points:
            raise BenchError(f"{self.folder} has no level with values; see its reasons with rows().")
        first = points[0]
        data: dict[str, Any] = {name: ("level", [getattr(p, name) for p in points]) for name in _WITH_STD}
        for name in self._with_budget:
            data[name + _REPEATABILITY] = ("level", [self._repeatability(p, name) for p in points])
        data["force_harmonics"] = (("level", "order"), np.array([p.force_harmonics for p in points]))
        data["shape_harmonics"] = (("level", "order", "point"), np.array([p.shape_harmonics for p in points]))
        data["normalised_shape"] = (("level", "point"), np.array([p.normalised_shape for p in points]))
        data["participation"] = (("level", "mode"), np.array([p.participation for p in points]))
        coordinates = {
            "level": ("level", [p.level for p in points], {"units": first.level_unit}),
            "order": np.arange(first.harmonics + 1),
            "point": list(first.points),
            "mode": np.arange(1, len(first.participation) + 1),
        }
        return library.Dataset(data, coordinates, {"folder": str(self.folder), "rig": str(self.inputs.get("rig", ""))})

    def plot(self, y: str = "frequency_hz", x: str = "modal_amplitude", axes: Axes | None = None, **style: Any) -> Axes:
        """One property over another with standard uncertainties.

            Args:
                y: property of the ordinate.
                x: property of the abscissa, or ``level``.
                axes: to draw on; None = new ones.
                style: of :meth:`matplotlib.axes.Axes.errorbar`.

            Returns:
                The axes.

            Raises:
                BenchError: no such property exists.

        Examples:
            >>> nmt.open("out/demo").plot("damping_ratio").get_ylabel()
            'modal damping ratio'
            >>> nmt.open("out/demo").plot("force_n", x="level", color="k").get_xlabel()
            'level'
        """
        drawn = _axes(axes)
        across = np.array([p.level for p in self.good_points]) if x == "level" else self.values(x)
        spread = np.nan_to_num(self.values(f"{y}_std")) if hasattr(ModalPoint, f"{y}_std") else None
        drawn.errorbar(across, self.values(y), spread, **{"fmt": "o-", "capsize": 2.0, **style})
        if across.size and across.min() > 0.0 and across.max() > 5.0 * across.min():
            drawn.set_xscale("log")
        drawn.set_xlabel(_LABELS.get(x, x))
        drawn.set_ylabel(_LABELS.get(y, y))
        return drawn


@dataclass(frozen=True, repr=False)
class LinearResult(Results):
    """A linear modal test.

    Attributes:
        description: fitted modes and the drive point, as loop and extraction use them.
        document: everything in ``linear.json``.
        responses: frequency responses next to it; empty where there is no ``frf.csv``.
    """

    description: LinearDescription
    document: Mapping[str, Any] = field(default_factory=dict)
    responses: tuple[FrequencyResponseRecord, ...] = ()

    @classmethod
    def read(cls, folder: Path) -> LinearResult:
        """Read ``linear.json``, and ``frf.csv`` where there is one.

        Raises:
            BenchError: damaged.
        """
        from nmt_record.exchange.reduced.frf_table import read_frf_table

        document = read_json(folder / "linear.json", "linear test")
        description = LinearDescription.from_mapping(document)
        table = folder / "frf.csv"
        responses = read_frf_table(table, description.drive_point) if table.is_file() else []
        return cls(folder, description, document, tuple(responses))

    @property
    def _summary(self) -> str:
        modes = _counted(len(self.description.frequencies_rad_s), "mode")
        return f"{modes}, {_counted(len(self.responses), 'frequency response')}"

    def rows(self) -> list[dict[str, Any]]:
        """One row a mode."""
        own = self.description
        return [
            {
                "mode": number + 1,
                "target": number == own.target_mode,
                "frequency_hz": own.frequencies_rad_s[number] / _TAU,
                "damping_ratio": own.damping_ratios[number],
                **{f"shape_{point}": own.shapes[row][number] for row, point in enumerate(own.points)},
            }
            for number in range(len(own.frequencies_rad_s))
        ]

    def to_xarray(self) -> Any:
        """Modes and frequency responses as an ``xarray.Dataset``.

        ``natural_frequency_hz`` and ``damping_ratio`` over ``mode``, ``shape`` over point and mode. Where there is a
        ``frf.csv``: complex ``response`` over ``channel`` and ``frequency_hz``, NaN where a channel has no line.

        Raises:
            BenchError: xarray is not installed.
        """
        own = self.description
        data: dict[str, Any] = {
            "natural_frequency_hz": ("mode", np.array(own.frequencies_rad_s) / _TAU, {"units": "Hz"}),
            "damping_ratio": ("mode", np.array(own.damping_ratios)),
            "shape": (("point", "mode"), np.array(own.shapes), {"units": "kg**-0.5"}),
        }
        coordinates: dict[str, Any] = {"mode": np.arange(1, len(own.frequencies_rad_s) + 1), "point": list(own.points)}
        if self.responses:
            frequency = np.unique(np.concatenate([response.frequency_hz for response in self.responses]))
            values = np.full((len(self.responses), frequency.size), np.nan + 0j)
            for row, response in enumerate(self.responses):
                values[row, np.searchsorted(frequency, response.frequency_hz)] = response.values
            data["response"] = (("channel", "frequency_hz"), values)
            coordinates |= {"channel": [response.name for response in self.responses], "frequency_hz": frequency}
        attributes = {"folder": str(self.folder), "target_mode": own.target_mode + 1, "drive_point": own.drive_point}
        return _xarray().Dataset(data, coordinates, attributes)

    def plot(self, axes: Axes | None = None, **style: Any) -> Axes:
        """Modulus of the frequency responses over frequency; style of :meth:`matplotlib.axes.Axes.loglog`.

        Raises:
            BenchError: there is no ``frf.csv``.
        """
        return _plot_responses(self.folder, self.responses, _axes(axes), style)


@dataclass(frozen=True, repr=False)
class FrequencyResponses(Results):
    """A sweep or stepped sine.

    Attributes:
        levels: one table a level.
    """

    levels: tuple[FrequencyResponseTable, ...] = ()

    @classmethod
    def read(cls, folder: Path) -> FrequencyResponses:
        """Read ``frf.csv`` of a sweep.

        Raises:
            BenchError: damaged, or the table of something else.
        """
        from nmt_extract.curves.response_table import read_response_csv

        return cls(folder, tuple(read_response_csv(folder / "frf.csv")))

    @property
    def _summary(self) -> str:
        return _counted(len(self.levels), "level")

    def rows(self) -> list[dict[str, Any]]:
        """One row a level, frequency and channel."""
        return [
            {
                "level": table.level,
                "level_unit": table.level_unit,
                "rate_hz_s": table.rate_hz_s,
                "frequency_hz": float(table.frequency_hz[line]),
                "channel": channel,
                "real": float(table.frf[row, line].real),
                "imag": float(table.frf[row, line].imag),
                "std": float(table.frf_std[row, line]),
                "force_n": float(table.force_n[line]),
                "voltage_v": float(table.voltage_v[line]),
            }
            for table in self.levels
            for row, channel in enumerate(table.channels)
            for line in range(table.frequency_hz.size)
        ]

    def to_xarray(self) -> Any:
        """All levels as an ``xarray.Dataset`` over ``level``, ``channel`` and ``line``.

        The levels may have other frequencies: ``frequency_hz`` is over level and line, and a level with fewer lines
        ends in NaN, as does a channel that a level lacks.

        Raises:
            BenchError: xarray is not installed.
        """
        library = _xarray()
        levels = self.levels
        channels = list(dict.fromkeys(name for table in levels for name in table.channels))
        lines = max((table.frequency_hz.size for table in levels), default=0)
        scalars = {name: np.full((len(levels), lines), np.nan) for name in ("frequency_hz", "force_n", "voltage_v")}
        response = np.full((len(levels), len(channels), lines), np.nan + 0j)
        spread = np.full(response.shape, np.nan)
        for number, table in enumerate(levels):
            own = slice(table.frequency_hz.size)
            for name, values in scalars.items():
                values[number, own] = getattr(table, name)
            rows = [channels.index(name) for name in table.channels]
            response[number, rows, own] = table.frf
            spread[number, rows, own] = table.frf_std
        per_line, per_channel = ("level", "line"), ("level", "channel", "line")
        unit = {"units": levels[0].level_unit} if levels else {}
        return library.Dataset(
            {
                "response": (per_channel, response),
                "response_std": (per_channel, spread),
                "force_n": (per_line, scalars["force_n"]),
                "voltage_v": (per_line, scalars["voltage_v"]),
                "rate_hz_s": ("level", np.array([table.rate_hz_s for table in levels])),
            },
            {
                "level": ("level", np.array([table.level for table in levels]), unit),
                "channel": channels,
                "frequency_hz": (per_line, scalars["frequency_hz"]),
            },
            {"folder": str(self.folder)},
        )

    def plot(self, channel: str | None = None, axes: Axes | None = None, **style: Any) -> Axes:
        """Modulus of one channel's response at every level.

        Args:
            channel: name; None = the first.
            axes: to draw on; None = new ones.
            style: of :meth:`matplotlib.axes.Axes.semilogy`.

        Raises:
            BenchError: no such channel exists.
        """
        drawn = _axes(axes)
        for table in self.levels:
            name = table.channels[0] if channel is None else channel
            if name not in table.channels:
                raise BenchError(f"The sweep has no channel '{name}'; it has {', '.join(table.channels)}.")
            response = np.abs(table.frf[table.channels.index(name)])
            label = f"{significant(table.level)} {table.level_unit}"
            drawn.semilogy(table.frequency_hz, response, **{"label": label, **style})
        drawn.set_xlabel("frequency / Hz")
        drawn.set_ylabel("response over force")
        drawn.legend()
        return drawn


@dataclass(frozen=True, repr=False)
class DiagnosisResult(Results):
    """A diagnosis of the gap between model and rig.

    Attributes:
        document: everything in ``diagnosis.json``.
    """

    document: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> DiagnosisResult:
        """Read ``diagnosis.json``.

        Raises:
            BenchError: damaged.
        """
        document = read_json(folder / "diagnosis.json", "diagnosis")
        missing = [name for name in ("verdict", "sentences", "ranking", "gap") if name not in document]
        if missing:
            raise BenchError(f"{folder / 'diagnosis.json'} is not a diagnosis: it has no '{missing[0]}'.")
        return cls(folder, document)

    @property
    def verdict(self) -> str:
        """``none``, ``calibration``, ``effect`` or ``unknown``."""
        return str(self.document["verdict"])

    @property
    def sentences(self) -> tuple[str, ...]:
        """Where, which, how far, what next."""
        return tuple(str(text) for text in self.document["sentences"])

    @property
    def closed(self) -> float:
        """Share of the gap on held-out data that the explanation closes; NaN where none was accepted."""
        value = self.document["gap"].get("closed")
        return math.nan if value is None else float(value)

    @property
    def _summary(self) -> str:
        return f"verdict {self.verdict}, {_counted(len(self.document['ranking']), 'explanation')}"

    columns = ("effect", "place", "detail", "probability", "closed", "parameters", "equivalents")

    def rows(self) -> list[dict[str, Any]]:
        """One row an explanation, the most probable first; none where the model needs no effect."""
        return [
            {
                "effect": entry["effect"],
                "place": entry["place"],
                "detail": entry.get("detail", ""),
                "probability": float(entry["probability"]),
                "closed": _closed_share(entry),
                "parameters": ", ".join(_parameter(name, item) for name, item in entry.get("parameters", {}).items()),
                "equivalents": ", ".join(map(str, entry.get("equivalents", ()))),
            }
            for entry in self.document["ranking"]
        ]

    def to_xarray(self) -> Any:
        """The residual map and the explanations as an ``xarray.Dataset``.

        Over ``row``: test, level, channel, harmonic and the residuals in standard deviations of the measurement. Over
        ``explanation``, the most probable first: the columns of :meth:`rows`, their names preceded by ``explanation_``.

        Raises:
            BenchError: xarray is not installed.
        """
        cells: Sequence[Mapping[str, Any]] = self.document.get("residual_map", ())
        data = {name: ("row", _column([cell[name] for cell in cells])) for name in (cells[0] if cells else ())}
        ranked = self.rows()
        for name in ranked[0] if ranked else ():
            data[f"explanation_{name}"] = ("explanation", _column([row[name] for row in ranked]))
        attributes = {"folder": str(self.folder), "verdict": self.verdict, "closed": self.closed}
        return _xarray().Dataset(data, attrs=attributes)

    def plot(self, axes: Axes | None = None, **style: Any) -> Axes:
        """Probabilities of the explanations as bars; style of :meth:`matplotlib.axes.Axes.barh`."""
        drawn = _axes(axes)
        rows = self.rows()[::-1]
        labels = [f"{row['effect']} ({row['detail'] or row['place']})" for row in rows]
        drawn.barh(labels, [row["probability"] for row in rows], **style)
        drawn.set_xlim(0.0, 1.0)
        drawn.set_xlabel("probability")
        return drawn


def _column(values: Sequence[Any]) -> NDArray[Any]:
    """Texts or numbers as one array; what JSON has no number for is NaN."""
    return np.array([math.nan if value is None else value for value in values])


def _closed_share(entry: Mapping[str, Any]) -> float:
    value = (entry.get("closed") or {}).get("value")
    return math.nan if value is None else float(value)


def _parameter(name: str, item: Mapping[str, Any]) -> str:
    std = item.get("std")
    return f"{name} = {uncertain(float(item['value']), math.nan if std is None else float(std))} {item.get('unit', '')}"


def _plot_responses(
    folder: Path, responses: Sequence[FrequencyResponseRecord], drawn: Axes, style: Mapping[str, Any]
) -> Axes:
    if not responses:
        raise BenchError(f"{folder} has no frf.csv, so there are no frequency responses.")
    for own in responses:
        drawn.loglog(own.frequency_hz, np.abs(own.values), **{"label": own.name, **style})
    drawn.set_xlabel("frequency / Hz")
    drawn.set_ylabel("response over force")
    drawn.legend()
    return drawn
