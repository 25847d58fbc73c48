"""Rigs taken apart, remembered while a prediction needs them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from nmt_diagnose.effects.rig_edit import with_exciters_at
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.prediction.gaussian_motion import DrivenForces
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import (
    RigParts,
    channel_sections,
    channel_table,
    limit_table,
    rig_parts,
    with_elements_of,
)
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.rig import Rig, ShakingTableSection


@dataclass(frozen=True)
class Setup:
    """What tests have in common that can share one linear model.

    Attributes:
        drive_points: point of each exciter.
        ideal_force: the exciter is left out.
        channels: all channels of these tests.
        basis: harmonic orders.
    """

    drive_points: tuple[int, ...]
    ideal_force: bool
    channels: tuple[MeasuredChannel, ...]
    basis: FourierBasis

    def index(self, channels: Iterable[MeasuredChannel]) -> list[int]:
        """Positions of a test's channels."""
        return [self.channels.index(channel) for channel in channels]


def joint_setup(setups: Iterable[Setup]) -> Setup:
    """One setup for several with the same drive points."""
    every = list(setups)
    channels = tuple(dict.fromkeys(channel for setup in every for channel in setup.channels))
    basis = max((setup.basis for setup in every), key=lambda basis: basis.size)
    return Setup(every[0].drive_points, every[0].ideal_force, channels, basis)


class PartsCache:
    """Parts of one rig at several moments.

    Args:
        settings: of the predictor.
        base: parts of a rig from which this one differs by an infinitesimal step.

    Attributes:
        base: the same.
        forces: local forces under random drives that predictors found, by predictor and moment.
    """

    def __init__(self, settings: PredictionSettings, base: PartsCache | None = None) -> None:
        self.settings = settings
        self.base = base
        self.forces: dict[tuple[object, float], DrivenForces] = {}
        self._known: dict[tuple[int, float, float], tuple[Rig, RigParts]] = {}
        # Rigs that differ from this one by an infinitesimal step and have more coordinates, the newest one each.
        self._wider: dict[tuple[Any, ...], tuple[Rig, RigParts]] = {}

    def parts(self, rig: Rig, setup: Setup, seconds: float = 0.0, cycles: float = 0.0) -> RigParts:
        """Parts of the rig in a setup, at a moment of its drift."""
        drift = rig.drift
        if drift.slip_force_per_s == 0.0 and drift.stiffness_per_s == 0.0:
            seconds = 0.0
        if drift.slip_force_per_cycle == 0.0:
            cycles = 0.0
        key = (id(setup), seconds, cycles)
        found = self._known.get(key)
        if found is None:
            near = self._near(key)
            parts = self._later(rig, setup, key) if near is None else self._shared(rig, setup, key, *near)
            places = (key, *(_place(e) for e in rig.local_elements))
            if parts is None and near is not None and self.base is not None:
                wider = self.base._wider.get(places)
                parts = None if wider is None else self._shared(rig, setup, key, *wider)
            if parts is None:
                parts = rig_parts(
                    with_exciters_at(rig, setup.drive_points), setup.channels, setup.basis, self.settings, seconds,
                    cycles, setup.ideal_force, None if near is None else near[1],
                    tuple(parts for _, parts in self._known.values()),
                )  # fmt: skip
                if near is not None and self.base is not None and len(rig.local_elements) > len(near[0].local_elements):
                    self.base._wider[places] = (rig, parts)
            found = (rig, parts)
            self._known[key] = found
        return found[1]

    def _later(self, rig: Rig, setup: Setup, key: tuple[int, float, float]) -> RigParts | None:
        """Parts of the rig at another moment where only its slip forces drift: its linear model stays."""
        if rig.drift.stiffness_per_s != 0.0:
            return None
        known = (parts for (number, _, _), (whose, parts) in self._known.items() if number == key[0] and whose is rig)
        earlier = next(known, None)
        if earlier is None:
            return None
        return with_elements_of(earlier, with_exciters_at(rig, setup.drive_points), self.settings, key[1], key[2])

    def _near(self, key: tuple[int, float, float]) -> tuple[Rig, RigParts] | None:
        """The base's rig and parts, at the same moment or without drift."""
        if self.base is None:
            return None
        return self.base._known.get(key) or self.base._known.get((key[0], 0.0, 0.0))

    def _shared(
        self, rig: Rig, setup: Setup, key: tuple[int, float, float], other: Rig, parts: RigParts
    ) -> RigParts | None:
        """Parts of the base with other sensors or other numbers of its nonlinear elements, where nothing else changes.

        Poles and residues are what a rig costs; they are the same then.
        """
        same = (
            _equal(rig.structure, other.structure)
            and _equal(rig.all_exciters, other.all_exciters)
            and (_equal(rig.drift, other.drift) or rig.drift.stiffness_per_s == other.drift.stiffness_per_s == 0.0)
            and (
                rig.sensors is other.sensors
                or all(
                    a is b or (a.mass_kg == b.mass_kg and a.transverse == b.transverse)
                    for a, b in zip(rig.sensors, other.sensors, strict=True)
                )
            )
        )
        if not same:
            return None
        moved = with_exciters_at(rig, setup.drive_points)
        if not (_equal(rig.local_elements, other.local_elements) and _equal(rig.drift, other.drift)):
            # A shaking table's effective mass is that of the rig with its elements at rest.
            if not _alike(rig, other, isinstance(rig.exciter, ShakingTableSection)):
                return None
            parts = with_elements_of(parts, moved, self.settings, key[1], key[2])
        sections = channel_sections(moved, setup.channels)
        return replace(
            parts,
            channels=channel_table(sections),
            limits=limit_table(sections, rig.sample_rate_hz),
            sections=sections,
            clock=1.0 + rig.clock_error,
        )


def _equal(a: object, b: object) -> bool:
    """Whether two sections are the same; a fit makes them anew at every step, most of them with the same numbers."""
    return a is b or a == b


def _place(element: ElementSection) -> tuple[Any, ...]:
    """Where an element acts, and along which direction."""
    return element.point, element.other_point, element.rotation, element.reversed, element.side


def _alike(rig: Rig, other: Rig, same_modes_at_rest: bool) -> bool:
    """Whether two rigs have the same local elements but for kinds and numbers of the nonlinear ones.

    ``same_modes_at_rest`` asks for those, too.
    """
    if len(rig.local_elements) != len(other.local_elements):
        return False
    return all(
        _equal(a, b)
        or (
            not {a.kind, b.kind} & {"linear_spring", "linear_damper"}
            and (not same_modes_at_rest or (a.soft_at_rest and b.soft_at_rest))
            and _place(a) == _place(b)
            and getattr(a, "remaining_stiffness_n_m", 0.0) == getattr(b, "remaining_stiffness_n_m", 0.0)
        )
        for a, b in zip(rig.local_elements, other.local_elements, strict=True)
    )
