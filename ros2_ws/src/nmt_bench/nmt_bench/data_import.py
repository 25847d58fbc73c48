"""Data measured elsewhere becomes a bag, with the rig file and the linear modes that its sidecar names."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import, write_import
from nmt_record.exchange.sidecar.import_sidecar import Sidecar
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import Rig, ShakingTableSection, find_rig, load_rig
from nmt_rig.rig_snapshot import rig_text
from nmt_session.versions import versions

_SAME_MODE = 0.2
_NODE = 0.02


def import_data(sidecar: Path | str, bag: Path | str) -> ImportedRun:
    """Read and check data measured elsewhere, and write them as a bag.

    Args:
        sidecar: YAML file that says what the columns of the data are; the data lie next to it.
        bag: folder of the bag; must not exist yet.

    Returns:
        What was read: channels in SI units, segments, tables, and in ``notes`` what was fixed.

    Raises:
        BenchError: the sidecar, the rig it names or the data are wrong, or the bag cannot be written.

    Examples:
        >>> data = nmt.import_data("out/exported/sidecar.yaml", "out/imported")
        >>> len(data.segments)
        2
        >>> nmt.Bag.open("out/imported").lock_events()[1].level
        0.6
    """
    imported, rig = read_data(Path(sidecar))
    write_data(imported, rig, Path(bag))
    return imported


def read_data(sidecar: Path) -> tuple[ImportedRun, RigOfImport]:
    """Read and check what :func:`import_data` writes.

    Raises:
        BenchError: the sidecar, the rig it names or the data are wrong.
    """
    rig = RigOfImport(sidecar)
    imported = read_import(sidecar, rig.describe, rig.shape_sign)
    rig.resolve(imported.sidecar)
    imported.notes += rig.notes
    if imported.sidecar.extraction is not None:
        ExtractionSettings.from_mapping(imported.sidecar.extraction)
    return imported, rig


def write_data(imported: ImportedRun, rig: RigOfImport, bag: Path) -> None:
    """Write the bag.

    Raises:
        BenchError: the folder exists or cannot be written.
    """
    write_import(imported, bag, rig.name, rig.text, versions())


class RigOfImport:
    """The rig that a sidecar names, if there is a file for it."""

    def __init__(self, sidecar: Path) -> None:
        self._folder = sidecar.parent
        self._resolved = False
        self._linear: LinearDescription | None = None
        self._rig: Rig | None = None
        self.name = ""
        self.text = ""
        self.notes: list[str] = []

    def describe(self, sidecar: Sidecar) -> LinearDescription | None:
        """Linear modes of the rig's model at the points that were measured."""
        self.resolve(sidecar)
        return self._linear

    def shape_sign(self, point: int, drive_point: int, frequency_hz: float) -> float:
        """Sign of a response at a resonance, from the nearest mode of the rig's model; 0 without one.

        Args:
            point: of the response; 0 = that of the exciter.
            drive_point: of the force; 0 = that of the exciter.
            frequency_hz: of the resonance.
        """
        if self._rig is None:
            return 0.0
        try:
            linear = linear_description(self._rig)
        except BenchError:
            return 0.0
        at, driven = (value or self._rig.drive_point for value in (point, drive_point))
        if isinstance(self._rig.exciter, ShakingTableSection) or not {at, driven} <= set(linear.points):
            return 0.0
        frequencies = [abs(omega) / (2.0 * math.pi) for omega in linear.frequencies_rad_s]
        nearest = min(range(len(frequencies)), key=lambda mode: abs(frequencies[mode] - frequency_hz))
        if abs(frequencies[nearest] / frequency_hz - 1.0) > _SAME_MODE:
            return 0.0
        product = linear.shapes[linear.points.index(at)][nearest] * linear.shapes[linear.points.index(driven)][nearest]
        largest = max(abs(row[nearest]) for row in linear.shapes) ** 2
        # Near a node the model does not know the sign.
        return math.copysign(1.0, product) if abs(product) > _NODE * largest else 0.0

    def resolve(self, sidecar: Sidecar) -> None:
        """Find and load the rig file.

        Raises:
            BenchError: a path that leads nowhere, or a rig file with a mistake.
        """
        if self._resolved or sidecar.rig is None:
            return
        self._resolved = True
        path = self._find(sidecar.rig)
        if path is None:
            self.name = sidecar.rig
            self.notes.append(f"There is no rig file '{sidecar.rig}'; the bag names the rig and holds no file of it.")
            return
        rig = load_rig(path, vibrating=False)
        overrides = []
        points = {channel.point for channel in sidecar.channels if channel.quantity == "force" and channel.point}
        if len(points) == 1 and points != {rig.drive_point}:
            overrides = [f"exciter.point={points.pop()}"]
            rig = load_rig(path, overrides, vibrating=False)
            self.notes.append(f"The force was measured at point {rig.drive_point}; the rig's exciter was put there.")
        self._rig = rig
        self.name, self.text = rig.name, rig_text(rig, path, overrides)
        if sidecar.linear is None and sidecar.channels:
            self._linear = self._modes(rig, sidecar)

    def _modes(self, rig: Rig, sidecar: Sidecar) -> LinearDescription | None:
        """Linear modes of the rig at the measured points; None where it swings in none."""
        try:
            linear = linear_description(rig)
        except BenchError:
            self.notes.append(
                f"The model {rig.name} swings in no mode, so the bag holds no linear modes; the force of its records "
                "is predicted from their motion."
            )
            return None
        return self._measured(linear, sidecar)

    def _find(self, name: str) -> Path | None:
        rig_file = self._folder / name
        if rig_file.is_file():
            return rig_file
        if "/" in name or name.endswith((".yaml", ".yml")):
            raise BenchError(
                f"The sidecar names the rig file {name}, which is not next to it ({rig_file}); correct 'rig'."
            )
        try:
            return find_rig(name)
        except BenchError:
            return None

    def _measured(self, linear: LinearDescription, sidecar: Sidecar) -> LinearDescription | None:
        """The description restricted to the points that one kind of sensor covers."""
        best: list[int] = []
        for quantity in ("displacement", "velocity", "acceleration"):
            points = {channel.point for channel in sidecar.channels if channel.quantity == quantity}
            rows = [row for row, point in enumerate(linear.points) if point in points]
            best = rows if len(rows) > len(best) else best
        if len(best) == len(linear.points):
            return linear
        if not best or len(best) <= linear.target_mode:
            self.notes.append("The rig's model has no modes at the measured points, so the bag holds no linear modes.")
            return None
        modes = min(len(best), len(linear.frequencies_rad_s))
        kept = tuple(linear.points[row] for row in best)
        self.notes.append(
            f"The rig's linear modes were restricted to the measured points {', '.join(map(str, kept))} "
            f"({modes} mode{'s' if modes > 1 else ''})."
        )
        return dataclasses.replace(
            linear,
            points=kept,
            frequencies_rad_s=linear.frequencies_rad_s[:modes],
            damping_ratios=linear.damping_ratios[:modes],
            shapes=tuple(linear.shapes[row][:modes] for row in best),
        )
