"""What a file of matrices says of a structure, in figures that its owner knows: nodes, mass, first frequencies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nmt_core.errors import BenchError
from nmt_rig.file_errors import BadFileError
from nmt_rig.matrix_files import read_model
from nmt_rig.model.matrix_structure import Matrices, lowest_frequencies
from nmt_rig.named_rows import Units, direction_words

# Nodes that are listed by number; of more the first and the last.
_LISTED = 12
_FREQUENCIES = 6


@dataclass(frozen=True)
class ModelFigures:
    """Figures of the structure that files describe, in SI units.

    Attributes:
        rows: number of rows.
        nodes: their nodes; empty where no file names them.
        modal_coordinates: rows that belong to no direction of a node.
        directions: names of their directions.
        massless_rows, held_rows: rows that follow statically, and that were left out as the program holds them.
        mass_kg: by direction.
        frequencies_hz: the lowest ones of the structure as it is in the file, 0 for rigid-body modes.
        extent_m: of the nodes in x, y and z; empty where no file has coordinates.
        has_damping: whether there is a damping matrix.
        doubt_of_units: why the figures cannot be in these units; empty where they can.
    """

    rows: int
    nodes: list[int]
    modal_coordinates: int
    directions: str
    massless_rows: int
    held_rows: int
    mass_kg: dict[str, float]
    frequencies_hz: list[float]
    extent_m: list[float]
    has_damping: bool
    doubt_of_units: str

    def lines(self, units: str) -> list[str]:
        """One sentence for each thing."""
        numbers = [str(node) for node in self.nodes]
        if len(numbers) > _LISTED:
            numbers = [*numbers[:3], "…", numbers[-1]]
        named = (
            f"{len(self.nodes)} nodes ({', '.join(numbers)}) in {self.directions}" if self.nodes else "without names"
        )
        if self.modal_coordinates:
            named += f", {self.modal_coordinates} coordinates of modes"
        masses = ", ".join(f"{mass:.6g} kg in {name}" for name, mass in self.mass_kg.items())
        free = sum(frequency == 0.0 for frequency in self.frequencies_hz)
        others = ", ".join(f"{frequency:.6g}" for frequency in self.frequencies_hz if frequency > 0.0)
        return [
            f"rows: {self.rows}, {named}",
            f"mass: {masses or 'not known without names of the rows'}",
            f"frequencies: {f'{free} of rigid-body modes, then ' if free else ''}{others or 'none'} Hz",
            f"rows without mass: {self.massless_rows}, which follow the others statically",
            *([f"held rows: {self.held_rows}, left out"] if self.held_rows else []),
            *([f"nodes reach over {' x '.join(f'{side:.4g}' for side in self.extent_m)} m"] if self.extent_m else []),
            f"damping matrix: {'yes' if self.has_damping else 'none; give damping_ratios'}",
            f"units of the file: {units}",
            *([f"in these units {self.doubt_of_units}: state others, as mm-t-N"] if self.doubt_of_units else []),
        ]


def model_figures(paths: Mapping[str, Path], units: str) -> ModelFigures:
    """Read files of matrices and say what they hold.

    Args:
        paths: as for :func:`nmt_rig.matrix_files.read_model`.
        units: of the files, as mm-t-N.

    Raises:
        BenchError: a file that cannot be read, or matrices that are no passive structure.
    """
    try:
        model = read_model(paths)
        system = Units.named(units)
        for quantity in ("mass", "stiffness"):
            if quantity not in model.matrices:
                raise BadFileError(f"the {quantity} matrix is missing")
        matrices = Matrices(**system.in_si(model.matrices, ())).checked()
        frequencies = lowest_frequencies(matrices, _FREQUENCIES) / (2.0 * np.pi)
    except OSError as error:
        raise BenchError(f"{error.filename} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:
        names = ", ".join(path.name for path in paths.values())
        # A reader names the one of several files.
        where = "" if any(str(error).startswith(f"{path.name}: ") for path in paths.values()) else f"{names}: "
        raise BenchError(f"{where}{error}.") from error
    scaled = model.in_metres(system)
    labels = np.zeros(0, np.int64) if scaled.labels is None else scaled.labels[scaled.labels % 100 > 0]
    return ModelFigures(
        rows=matrices.size,
        nodes=np.unique(labels // 100).tolist(),
        modal_coordinates=0 if scaled.labels is None else scaled.labels.size - labels.size,
        directions=direction_words(labels % 100) if labels.size else "",
        massless_rows=int(matrices.massless().size),
        held_rows=model.held,
        mass_kg=scaled.mass_by_direction(),
        frequencies_hz=frequencies.tolist(),
        extent_m=np.ptp(scaled.nodes[:, 1:], axis=0).tolist() if scaled.nodes.size else [],
        has_damping=matrices.damping is not None,
        doubt_of_units=scaled.doubt_of_units(),
    )
