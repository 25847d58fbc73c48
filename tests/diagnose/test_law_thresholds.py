"""What decides at the thresholds of laws: values just below and just above them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.simulated_levels import FORCES, chain_of_masses, held, levels_of

from nmt_diagnose.law import reading
from nmt_diagnose.law.force_loop import ForceLoop
from nmt_diagnose.law.law_blocks import Block, blocks
from nmt_diagnose.law.law_rows import LawRows
from nmt_diagnose.law.law_search import LawSearch, fewest, moves_enough
from nmt_diagnose.law.modal_frame import ModalFrame
from nmt_diagnose.law.nuisance import _of_other_modes
from nmt_diagnose.law.terms import Term
from nmt_diagnose.search import law_starts
from nmt_diagnose.search.law_starts import effects_of_law, worth_a_start


def test_rows_and_errors_are_as_uncertain_as_stated() -> None:
    levels = levels_of(held(forces=FORCES[:4]))
    assert levels is not None
    frame = ModalFrame.of(chain_of_masses(), levels)
    assert frame is not None
    rows = LawRows(frame, levels)
    modal = abs(frame.drive[0, frame.target])
    sizes = np.abs(levels.motion[:, :, 1])
    repeats = np.hypot(levels.motion_std[:, :, 1], 1e-4 * sizes)
    q_std = np.sqrt((rows.take_q[0] ** 2 * repeats**2).sum(axis=1))
    force = np.abs(levels.force[0, :, 1])
    parts = [
        modal * levels.force_std[0], 0.002 * modal * force, 0.02 * np.abs(rows.measured[:, 0]),
        np.abs(rows.near[:, 0]) * q_std,
    ]  # fmt: skip
    assert rows.sigma[:, 0] == pytest.approx(np.sqrt(sum(part**2 for part in parts)), rel=1e-9)
    size = np.abs(levels.motion[:, 0, 1])
    assert np.hypot(levels.motion_std[:, 0, 1], 1e-4 * size) == pytest.approx(rows.sigma[:, 1], rel=1e-2)
    doubt = np.hypot(0.02, frame.tolerance(levels.omega, 2, 0.01, 0.3)[:, 0])
    second = np.abs(levels.motion[:, 0, 2])
    spread = np.sqrt(levels.motion_std[:, 0, 2] ** 2 + (doubt * second) ** 2 + (1e-5 * size) ** 2)
    assert rows.sigma[:, 5] == pytest.approx(spread, rel=1e-9)
    search = LawSearch(rows, chain_of_masses())
    columns = dict(zip(search.basis.names, np.moveaxis(search.basis.nuisance, -1, 0), strict=True))
    q = np.abs(rows.coordinate([])[:, 0])
    omega, zeta = frame.omega[frame.target], frame.zeta[frame.target]
    sizes = {
        name: np.hypot(column[:, 0], column[:, column.shape[1] // 2]) * rows.sigma[:, 0]
        for name, column in columns.items()
    }
    assert sizes["frequency of the mode"] == pytest.approx(0.01 * 2.0 * omega**2 * q, rel=1e-6)
    assert sizes["damping of the mode"] == pytest.approx(
        max(0.3 * zeta, 2e-4) * 2.0 * omega * levels.omega * q, rel=1e-6
    )
    gain = columns["gain of a1"][:, 2] ** 2 + columns["gain of a1"][:, 2 + columns["gain of a1"].shape[1] // 2] ** 2
    share = rows.shapes[1, 0] * rows.shapes[0, 0] * rows.take_q[0, 0]
    form = 0.01 * max(1.0, np.sqrt(np.mean(rows.shapes**2)) / abs(rows.shapes[0, 0]))
    assert np.sqrt(gain) * rows.sigma[:, 2] == pytest.approx(np.hypot(0.01, form) * abs(share) * q, rel=1e-3)


def test_the_damping_that_a_model_without_any_may_lack_is_stated() -> None:
    rig = chain_of_masses()
    structure = rig.structure.model_copy(update={"dampers_ns_m": [0.0] * 3, "ground_dampers_ns_m": [0.0] * 4})
    levels = levels_of(held(forces=FORCES[:4]))
    assert levels is not None
    rig = rig.model_copy(update={"structure": structure})
    frame = ModalFrame.of(rig, levels)
    assert frame is not None
    rows = LawRows(frame, levels)
    search = LawSearch(rows, rig)
    column = search.basis.nuisance[:, :, list(search.basis.names).index("damping of the mode")]
    found = np.hypot(column[:, 0], column[:, column.shape[1] // 2]) * rows.sigma[:, 0]
    q = np.abs(rows.coordinate([])[:, 0])
    assert found == pytest.approx(2e-4 * 2.0 * frame.omega[frame.target] * levels.omega * q, rel=1e-6)


def law(score: float, elements: int = 1, **more: Any) -> Any:
    return SimpleNamespace(score=score, elements=elements, **more)


def shares_of(after: float, before: float = 1.0) -> Any:
    return SimpleNamespace(after=after, before=before)


def refused(score: float, pull: float, above: float = 0.9) -> bool:
    best = law(score, fit=SimpleNamespace(nuisance=np.array([pull]), names=("gain",)))
    return bool(reading._refusals(best, 1.0, above))


def has_second(first: float, second: float, without: float = 10.0) -> bool:
    fit = SimpleNamespace(nuisance=np.zeros(0), names=())
    pair = law(second, 2, fit=fit)
    search: Any = SimpleNamespace(found=lambda _: [pair], null=SimpleNamespace(score=without))
    return reading._with_second(search, law(first, fit=fit)) is pair


def is_looked_for(score: float) -> bool:
    search: Any = SimpleNamespace(null=SimpleNamespace(score=score), found=lambda: [])
    levels: Any = SimpleNamespace(name="levels", count=5)
    return "noise" not in reading._read(search, levels).refusals[0]


def largest_slip() -> float:
    turn = np.linspace(0.0, 2.0 * np.pi, 64)
    (block,) = blocks(np.cos(turn)[np.newaxis], np.sin(turn)[np.newaxis])["sliders"]
    return float(block.terms[-1].first)


def dry_slip(smallest: float = 1e-3) -> float:
    """Slip displacement that stands for dry friction that was visited up to 1 mm, with a smallest level, m."""
    term = reading.LawTerm("friction", (0.01,), 2.0, 0.0, "N")
    motion = (-smallest, 0.0, smallest, 0.0)
    loop = ForceLoop(1, motion, motion, motion, motion, motion)
    ((_, values),) = effects_of_law(reading.LocalLaw(1, 0, "", (term,), 1e-3, (), (loop,)))
    return values["slip_displacement"]


EDGES = {
    "fewest_levels": lambda: [
        reading.read_law(chain_of_masses(), held(forces=FORCES[:count])) is None for count in (3, 4)
    ] == [True, False],
    "least_motion_share": lambda: moves_enough(np.array([1.0, 0.031, 0.029])).tolist() == [True, True, False],
    "largest_slip_share": lambda: abs(largest_slip() - 0.7) < 1e-9,
    "alike_score_ratio": lambda: [fewest([law(1.0, 3), law(s, 1)]).elements for s in (1.11, 1.13)] == [1, 3],
    "place_score_ratio": lambda: [reading.nearly_as_well(s, 1.0) for s in (1.29, 1.31)] == [True, False],
    "told_score_ratio": lambda: [refused(score, 0.0) for score in (0.49, 0.51)] == [False, True],
    "pull_sigmas": lambda: [refused(0.1, pull) for pull in (2.9, 3.1)] == [False, True],
    "second_score_ratio": lambda: [has_second(4.0, 4.0 * share) for share in (0.74, 0.76)] == [True, False],
    "single_closure": lambda: [has_second(2.0, 1.3, 1.0 + 1.0 / left) for left in (0.051, 0.049)] == [True, False],
    "clear_score_ratio": lambda: [has_second(2.0, 2.0 * share, 100.0) for share in (0.49, 0.51)] == [True, False],
    "second_from_score": lambda: [has_second(first, 0.1, 1.0) for first in (0.49, 0.51)] == [False, True],
    "least_null_score": lambda: [is_looked_for(score) for score in (0.99, 1.01)] == [False, True],
    "start_score_ratio": lambda: [worth_a_start(shares_of(score)) for score in (0.79, 0.81)] == [True, False],
    "dry_stick_share": lambda: abs(dry_slip(5e-5) - 0.2 * 5e-5) < 1e-12,
    "dry_slip_share": lambda: abs(dry_slip() - 0.02 * 1e-3) < 1e-12,
}  # fmt: skip


def test_a_second_law_is_looked_for_where_the_first_needs_a_pull() -> None:
    """It is taken where it takes the pull off, however little the score falls."""

    def chosen(pulls: tuple[float, float], score: float) -> bool:
        fits = [SimpleNamespace(nuisance=np.array([pull]), names=("gain",)) for pull in pulls]
        pair = law(score, 2, fit=fits[1])
        search: Any = SimpleNamespace(found=lambda _: [pair], null=SimpleNamespace(score=10.0))
        return reading._with_second(search, law(0.4, fit=fits[0])) is pair

    assert [chosen((pull, 0.0), 0.39) for pull in (2.9, 3.1)] == [False, True]
    assert [chosen((3.5, pull), 0.39) for pull in (2.9, 3.1)] == [True, False]
    assert not chosen((3.5, 0.0), 0.41)


def test_what_does_not_slip_at_the_levels_below_predicts_nothing_of_those_above() -> None:
    motion = np.zeros((4, 16), complex)
    motion[:, 1] = np.array([1.0, 2.0, 3.0, 4.0]) * 1e-3
    sliders = Block("sliders", tuple(Term("slider", slip) for slip in (1e-3, 1.9e-3, 2.1e-3)))
    one = Block("slider", (Term("slider", 2.5e-3),))
    search: Any = SimpleNamespace(rows=SimpleNamespace(levels=SimpleNamespace(omega=np.full(4, 100.0))))
    for block, expected in ((sliders, [True, True, False]), (one, [True])):
        best: Any = SimpleNamespace(parts=((None, block),), motions=(motion,))
        assert reading._slipping(search, best, 2).tolist() == expected


def test_a_law_that_makes_the_top_levels_worse_is_refused() -> None:
    assert [refused(0.1, 0.0, above) for above in (0.01, -0.01, float("nan"))] == [False, True, False]


@pytest.mark.parametrize("name", EDGES)
def test_a_threshold_decides(name: str) -> None:
    assert EDGES[name]()


def test_errors_of_other_modes_are_what_a_moved_model_makes_of_a_law() -> None:
    """Columns against rows of a model whose third mode is moved by a part of one standard deviation."""
    levels = levels_of(held(forces=FORCES[:4]))
    assert levels is not None
    frame = ModalFrame.of(chain_of_masses(), levels)
    assert frame is not None
    rows, place = LawRows(frame, levels), frame.at(3)
    force = np.zeros((4, 16), complex)
    force[:, 1:6] = 100.0 * (1.0 + 0.3j) ** np.arange(5)
    columns = dict(_of_other_modes(rows, [(place, force)]))
    step, here = 1e-5, rows.of_force(place, force)
    for what, std in (("frequency", 0.01), ("damping", 0.3)):
        moved = getattr(frame, {"frequency": "omega", "damping": "zeta"}[what]).copy()
        moved[2] *= 1.0 + step * std
        # The damping of a mode is 2ζω: what its frequency is moved by leaves it.
        zeta = frame.zeta * (frame.omega / moved) if what == "frequency" else moved
        omega = moved if what == "frequency" else frame.omega
        changed = LawRows(replace(frame, omega=omega, zeta=zeta), levels).of_force(place, force) - here
        assert (
            np.abs(changed / step - columns[f"{what} of mode 3 at its harmonics"]).max()
            < 1e-3 * np.abs(changed / step).max()
        )


@pytest.mark.parametrize(
    ("held", "driven", "expected"),
    [("empty", "stated", "driven"), ("refused", "stated", "driven"), ("stated", "stated", "held"),
     ("empty", "refused", "driven"), ("refused", "refused", "held"), ("empty", "empty", "held"),
     ("none", "stated", "driven"), ("fails", "stated", "driven"), ("none", "none", None)],
)  # fmt: skip
def test_a_reading_without_a_law_hides_none(held: str, driven: str, expected: str | None) -> None:
    """Of held levels and of driven records of the same specimen."""
    law = reading.LocalLaw(1, 0, "dry friction", (), 1e-3, (), ())

    def read(name: str, how: str) -> Any:
        def of(rig: Any, observations: Any) -> Any:
            if how == "fails":
                raise ArithmeticError
            laws, why = () if how == "empty" else (law,), () if how == "stated" else ("why",)
            return None if how == "none" else reading.LawReading(name, 9, laws, 9.0, 1.0, 0.9, 0.9, why)

        return of

    with pytest.MonkeyPatch.context() as patch:
        for name, how in (("read_law", held), ("read_record_law", "none"), ("read_driven_law", driven)):
            patch.setattr(law_starts, name, read("held" if name == "read_law" else "driven", how))
        found = law_starts.law_of(None, None)  # type: ignore[arg-type]
    assert (None if found is None else found.test) == expected
