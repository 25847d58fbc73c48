"""Sections of a rig file that describe the linear structure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from nmt_rig.model.beam import Boundary
from nmt_rig.model.packed_matrix import unpacked
from nmt_rig.rig_section import NotNegative, Point, Positive, Section


class AddedMassSection(Section):
    """Mass fixed to a point; negative where the model has too much."""

    point: Point
    mass_kg: float


class OscillatorSection(Section):
    """Mass on a spring and a damper at a point: one more degree of freedom."""

    point: Point
    mass_kg: Positive
    frequency_hz: Positive
    damping_ratio: NotNegative = 0.0


class StructureSection(Section):
    """Common keys of structures: masses and oscillators at points, hysteretic damping, factors on modes' damping."""

    added_masses: Annotated[list[AddedMassSection], Field(default_factory=list)]
    oscillators: Annotated[list[OscillatorSection], Field(default_factory=list)]
    loss_factor: NotNegative = 0.0
    damping_factors: Annotated[list[NotNegative], Field(default_factory=list)]


class BeamSection(StructureSection):
    """Uniform beam of Euler-Bernoulli elements; points are numbered from the left end."""

    kind: Literal["beam"]
    boundary: Boundary = "clamped-free"
    length_m: Positive
    width_m: Positive
    height_m: Positive
    youngs_modulus_pa: Positive
    density_kg_m3: Positive
    elements: Annotated[int, Field(ge=1, le=200)]
    stiffness_damping_s: NotNegative = 0.0
    mesh_refinement: Annotated[int, Field(ge=1, le=20)] = 1
    clamp_rotational_stiffness_nm_rad: Positive | None = None
    clamp_lateral_stiffness_n_m: Positive | None = None
    suspension_stiffness_n_m: NotNegative = 0.0
    suspension_damping_ns_m: NotNegative = 0.0

    @property
    def points(self) -> range:
        """Numbers of the measurement points."""
        if self.boundary == "free-free":
            return range(1, self.elements + 2)
        return range(1, self.elements + (1 if self.boundary == "clamped-free" else 0))

    @model_validator(mode="after")
    def _ends_fit(self) -> BeamSection:
        if "free" not in self.boundary and self.elements < 2:
            raise ValueError(f"elements must be at least 2 for a {self.boundary} beam, got {self.elements}")
        for key in ("clamp_rotational_stiffness_nm_rad", "clamp_lateral_stiffness_n_m"):
            if getattr(self, key) is not None and "clamped" not in self.boundary:
                raise ValueError(f"{key} needs a clamped end, and the beam is {self.boundary}; remove it")
        for key in ("suspension_stiffness_n_m", "suspension_damping_ns_m"):
            if getattr(self, key) and self.boundary != "free-free":
                raise ValueError(f"{key} carries a free-free beam, and this one is {self.boundary}; remove it")
        return self


class ChainSection(StructureSection):
    """Lumped masses in a row; point i = mass i."""

    kind: Literal["chain"]
    masses_kg: Annotated[list[Positive], Field(min_length=1, max_length=200)]
    springs_n_m: Annotated[list[NotNegative], Field(default_factory=list)]
    dampers_ns_m: list[NotNegative] | None = None
    ground_springs_n_m: list[NotNegative] | None = None
    ground_dampers_ns_m: list[NotNegative] | None = None

    @property
    def points(self) -> range:
        """Numbers of the measurement points."""
        return range(1, len(self.masses_kg) + 1)

    @model_validator(mode="after")
    def _lengths_fit(self) -> ChainSection:
        n = len(self.masses_kg)
        for key, count in (
            ("springs_n_m", n - 1),
            ("dampers_ns_m", n - 1),
            ("ground_springs_n_m", n),
            ("ground_dampers_ns_m", n),
        ):
            value = getattr(self, key)
            if value is not None and len(value) != count:
                raise ValueError(f"{key} needs {count} values for {n} masses, got {len(value)}")
        return self


class ModeSection(Section):
    """One real mode; its shape in any scale, which the modal mass belongs to (1 = mass-normalised)."""

    frequency_hz: NotNegative
    damping_ratio: Annotated[float, Field(ge=0, lt=1)] = 0.0
    modal_mass_kg: Positive = 1.0
    shape: Annotated[list[float], Field(default_factory=list)]
    participation: float | None = None


class ResidualSection(Section):
    """What modes above the measured ones contribute at low frequency."""

    flexibility_m_n: Annotated[list[list[float]], Field(min_length=1)]
    frequency_hz: Positive
    damping_ratio: Annotated[float, Field(ge=0, lt=1)] = 0.01


class ModalSection(StructureSection):
    """Structure given by its modes at numbered points; from a file, the rig holds what the file says."""

    kind: Literal["modal"]
    points: Annotated[list[Point], Field(min_length=1, max_length=200, default_factory=lambda: [1])]
    modes: Annotated[list[ModeSection], Field(max_length=100, default_factory=list)]
    residual: ResidualSection | None = None
    shape_std: Annotated[float, Field(ge=0, lt=1)] = 0.01
    base_motion: list[float] | None = None
    file: str | None = None
    direction: Literal["x", "y", "z"] = "z"
    source: str = ""

    @model_validator(mode="after")
    def _fits(self) -> ModalSection:
        count = len(self.points)
        if not self.modes:
            raise ValueError("needs modes, a list with frequency_hz, damping_ratio and shape, or a file that has them")
        if len(set(self.points)) != count:
            raise ValueError(f"points must differ from each other, got {self.points}")
        for number, mode in enumerate(self.modes):
            if len(self.shape(number)) != count:
                raise ValueError(
                    f"modes.{number}.shape needs one entry for each of the {count} points, got {len(mode.shape)}"
                )
            if not any(self.shape(number)):
                raise ValueError(f"modes.{number}.shape must not be zero at all points")
        if self.base_motion is not None and len(self.base_motion) != count:
            raise ValueError(f"base_motion needs one entry for each of the {count} points, got {len(self.base_motion)}")
        if self.residual is not None:
            rows = self.residual.flexibility_m_n
            if len(rows) != count or any(len(row) != count for row in rows):
                raise ValueError(f"residual.flexibility_m_n must have {count} rows of {count} numbers")
            if self.residual.frequency_hz <= max(mode.frequency_hz for mode in self.modes):
                raise ValueError("residual.frequency_hz must lie above the frequencies of all modes")
        return self

    def shape(self, mode: int) -> list[float]:
        """Shape of a mode at the points; 1 where there is one point and no shape."""
        return self.modes[mode].shape or ([1.0] if len(self.points) == 1 else [])


class MatrixPointSection(Section):
    """Where a point moves in the matrices: a node and its direction, the node next to a place, or a row from 0."""

    point: Point
    row: Annotated[int, Field(ge=0)]
    rotation_row: Annotated[int, Field(ge=0)] | None = None
    node: int | None = None
    at: Annotated[list[float], Field(min_length=3, max_length=3)] | None = None
    direction: Literal["x", "y", "z", "rx", "ry", "rz"] | None = None
    rotation: Literal["rx", "ry", "rz"] | None = None


class RegionSection(Section):
    """A part of a finite-element model that may be off: its elements, its mass, or the support that it is."""

    nodes: Annotated[list[int], Field(default_factory=list)]
    within: Annotated[list[Annotated[list[float], Field(min_length=3, max_length=3)]], Field(max_length=2)] | None = (
        None
    )
    file: str | None = None
    held: bool = False
    stiffness_factor: Positive = 1.0
    mass_factor: Positive = 1.0
    compliance_m_n: NotNegative = 0.0
    rotational_compliance_rad_nm: NotNegative = 0.0
    stiffness_std: NotNegative = 0.0
    mass_std: NotNegative = 0.0
    stiffness_n_m: str | None = None
    mass_kg: str | None = None
    moved_kg: NotNegative = 0.0
    translation_rows: Annotated[list[int], Field(default_factory=list)]
    rotation_rows: Annotated[list[int], Field(default_factory=list)]

    @property
    def supports(self) -> tuple[tuple[list[int], float], ...]:
        """Rows that it holds, and the compliance of all their springs together; 0 = ideal."""
        return (
            (self.translation_rows, self.compliance_m_n),
            (self.rotation_rows, self.rotational_compliance_rad_nm),
        )

    @model_validator(mode="after")
    def _fits(self) -> RegionSection:
        absent = (
            ("stiffness_factor", self.stiffness_factor != 1.0, self.stiffness_n_m, "a stiffness of its own; give file"),
            ("mass_factor", self.mass_factor != 1.0, self.mass_kg, "a mass of its own"),
            ("compliance_m_n", self.compliance_m_n, self.translation_rows, "translations that it holds"),
            (
                "rotational_compliance_rad_nm",
                self.rotational_compliance_rad_nm, self.rotation_rows, "rotations that it holds",
            ),
        )  # fmt: skip
        for key, changed, part, needed in absent:
            if changed and not part:
                raise ValueError(f"{key} needs {needed}")
        return self


class MatricesSection(StructureSection):
    """Structure given by its matrices; from files or reduced, the rig holds the matrices that came out."""

    kind: Literal["matrices"]
    points_at: Annotated[list[MatrixPointSection], Field(min_length=1)]
    mass_kg: Annotated[list[list[float]], Field(default_factory=list)]
    stiffness_n_m: Annotated[list[list[float]], Field(default_factory=list)]
    damping_ns_m: list[list[float]] | None = None
    damping_ratios: Annotated[list[NotNegative], Field(min_length=1)] | None = None
    base_vector: list[float] | None = None
    base_load_kg: list[float] | None = None
    file: str | None = None
    mass_file: str | None = None
    stiffness_file: str | None = None
    damping_file: str | None = None
    rows_file: str | None = None
    nodes_file: str | None = None
    units: str | None = None
    modes: Annotated[int, Field(ge=0)] | None = None
    mass_factor: Positive = 1.0
    stiffness_factor: Positive = 1.0
    damping_factor: NotNegative = 1.0
    frequency_factors: Annotated[list[Positive], Field(default_factory=list)]
    regions: Annotated[dict[str, RegionSection], Field(default_factory=dict)]
    source: str = ""

    @property
    def held_rows(self) -> list[int]:
        """Rows that supports hold where they are ideal."""
        return [row for each in self.regions.values() for row in (*each.translation_rows, *each.rotation_rows)]

    @property
    def moving_rows(self) -> list[int]:
        """Rows that move: all but those of ideal supports."""
        ideal = {
            row
            for region in self.regions.values()
            for rows, compliance in region.supports
            if not compliance
            for row in rows
        }
        return [row for row in range(len(self.mass_kg)) if row not in ideal]

    @property
    def points(self) -> Sequence[int]:
        """Numbers of the measurement points."""
        return sorted(entry.point for entry in self.points_at)

    @model_validator(mode="after")
    def _fits(self) -> MatricesSection:
        if len({entry.point for entry in self.points_at}) != len(self.points_at):
            raise ValueError("points_at names a point twice")
        if self.damping_ns_m is not None and self.damping_ratios is not None:
            raise ValueError("damping_ns_m and damping_ratios both give the damping; remove one")
        n = len(self.mass_kg)
        for name, region in self.regions.items():
            for key in ("stiffness_n_m", "mass_kg"):
                text = getattr(region, key)
                if text is not None and unpacked(text).shape[0] != n:
                    raise ValueError(f"regions.{name}.{key} has {unpacked(text).shape[0]} rows, the structure {n}")
            if any(not 0 <= row < n for row in (*region.translation_rows, *region.rotation_rows)):
                raise ValueError(f"regions.{name} holds a row that is not one of 0 to {n - 1}")
        if own := {entry.row for entry in self.points_at} & set(self.held_rows):
            raise ValueError(f"row {min(own)} is a point's and held by a region")
        return self


AnyStructure = BeamSection | ChainSection | ModalSection | MatricesSection


def point_words(points: Sequence[int]) -> str:
    """Numbers of points for a message: 1 to 7, or 3, 5 and 9."""
    numbers: list[Any] = sorted(points)
    if numbers == list(range(1, len(numbers) + 1)):
        return f"points 1 to {numbers[-1]}" if len(numbers) > 1 else "point 1 only"
    words = ", ".join(map(str, numbers[:-1]))
    return f"points {words} and {numbers[-1]}" if words else f"point {numbers[0]} only"
