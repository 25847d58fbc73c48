"""Several units: components against closed forms, the band of the next unit, odd units, and one group end to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.court.small_rigs import backbone, diagnosed, one_mode_rig
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_diagnose.law.reading import LawReading, LocalLaw
from nmt_diagnose.ledger.diagnosis import Diagnosis, Ranked, Recalibrated, Share, Value, Verdict
from nmt_diagnose.say.sentences import UNITS_FIRST
from nmt_diagnose.units.random_effects import COVERAGE, FALSE_ALARM, Estimate, components
from nmt_diagnose.units.unit_group import UnitDiagnosis, unit_group
from nmt_diagnose.units.unit_table import read_unit_table
from nmt_report.group_report import group_page


def replaced_mode(rig, mass):
    """The rig of one mode with another modal mass, kg."""
    mode = rig.structure.modes[0].model_copy(update={"modal_mass_kg": mass})
    return rig.model_copy(update={"structure": rig.structure.model_copy(update={"modes": [mode]})})


def estimates(values, std):
    """One estimate a unit, or one a setting where the values of a unit are a list."""
    return [
        Estimate(f"unit {i + 1}", f"mounting {j + 1}", float(value), std)
        for i, each in enumerate(values)
        for j, value in enumerate(np.atleast_1d(each))
    ]


def test_equal_uncertainties_are_the_analysis_of_variance():
    """Balanced one-way layout: σ² within from the mean squares, between from the means less their share of it."""
    random = np.random.default_rng(3)
    values = 5.0 + random.normal(0.0, 2.0, (6, 1)) + random.normal(0.0, 0.7, (6, 4))
    found = components(estimates(values, 0.1))
    within = values.var(axis=1, ddof=1).mean() - 0.1**2
    between = values.mean(axis=1).var(ddof=1) - (within + 0.1**2) / 4.0
    np.testing.assert_allclose(found.within_std, np.sqrt(within), rtol=1e-6)
    np.testing.assert_allclose(found.between_std, np.sqrt(between), rtol=1e-6)
    np.testing.assert_allclose(found.mean, values.mean(), rtol=1e-12)
    np.testing.assert_allclose(found.mean_std, np.sqrt(values.mean(axis=1).var(ddof=1) / 6.0), rtol=1e-6)


def test_alike_units_are_the_weighted_mean():
    found = components([Estimate("a", "", 1.0, 0.1), Estimate("b", "", 1.2, 0.2), Estimate("c", "", 0.9, 0.4)])
    weights = np.array([100.0, 25.0, 6.25])
    assert found.between_std == 0.0
    assert found.within_std is None
    np.testing.assert_allclose(found.mean, weights @ [1.0, 1.2, 0.9] / weights.sum(), rtol=1e-12)
    np.testing.assert_allclose(found.mean_std, weights.sum() ** -0.5, rtol=1e-12)


@pytest.mark.parametrize(
    ("between", "low", "high"),
    with_quick(
        [(0.0, 0.95, 1.0), (1.0, 0.95, 0.99), (3.0, 0.93, 0.97), (30.0, 0.93, 0.97)],
        (0.0, 0.95, 1.0),
        (3.0, 0.93, 0.97),
    ),
)
def test_the_band_holds_the_next_unit(between, low, high):
    random = np.random.default_rng(11)
    inside, alarms, trials = 0, 0, 300
    for _ in range(trials):
        values = random.normal(0.0, between, 6) + random.normal(0.0, 1.0, 6)
        found = components(estimates(values[:5], 1.0))
        inside += found.next_low <= values[5] <= found.next_high
        alarms += bool(found.odd)
    error = np.sqrt(COVERAGE * (1.0 - COVERAGE) / trials)
    assert low - 2.0 * error <= inside / trials <= high + 2.0 * error
    assert alarms / trials <= FALSE_ALARM + 3.0 * np.sqrt(FALSE_ALARM / trials)


def test_the_false_alarms_of_a_group_are_shared_by_its_parameters():
    """Eight parameters of five units that are alike: 2 % of groups, at the level of one parameter 14 %."""
    random, alarms, trials, parameters = np.random.default_rng(12), 0, 60, 8
    for _ in range(trials):
        groups = [estimates(random.normal(0.0, 3.0, 5), 0.3) for _ in range(parameters)]
        alarms += any(components(group, parameters).odd for group in groups)
    assert alarms / trials <= FALSE_ALARM + 3.0 * np.sqrt(FALSE_ALARM / trials)


def test_an_odd_unit_is_found_and_named():
    random = np.random.default_rng(5)
    right = 0
    for _ in range(40):
        values = random.normal(0.0, 1.0, 5)
        values[3] += 30.0
        odd = components(estimates(values, 0.3)).odd
        right += bool(odd) and odd[0].unit == "unit 4"
    assert right >= 36


def test_what_all_units_share_hides_no_odd_one_and_widens_no_band():
    """Each estimate is off by 5 % of itself, all alike, and by 0.5 % of its own; a unit of twice the value is odd."""
    random = np.random.default_rng(6)
    found = inside = 0
    trials = 150
    for _ in range(trials):
        values = 100.0 * (1.0 + 0.02 * random.standard_normal(6)) * (1.0 + 0.005 * random.standard_normal(6))
        values *= 1.0 + 0.05 * random.standard_normal()
        group = components([Estimate(f"unit {k}", "", value, 0.5, 5.0) for k, value in enumerate(values[:5])])
        inside += group.next_low <= values[5] <= group.next_high
        assert group.mean_std > 4.9
        values[2] *= 2.0
        odd = components([Estimate(f"unit {k}", "", v, v / 200.0, v / 20.0) for k, v in enumerate(values[:5])]).odd
        found += [each.unit for each in odd] == ["unit 2"]
    assert 0.93 - 0.03 <= inside / trials <= 0.97 + 0.03
    assert found >= 0.97 * trials


@pytest.mark.campaign
def test_what_is_shared_is_what_a_wrong_mass_of_the_model_does_to_all_units():
    """The backbone says k/m alone: of two models whose masses differ by a tolerance, both springs differ by it."""
    rig = one_mode_rig()
    light = diagnosed(rig, backbone(4, 3e9))
    tolerance = next(row.prior_std for row in light.calibration if "mass" in row.name)
    moved = diagnosed(replaced_mode(rig, rig.structure.modes[0].modal_mass_kg * (1.0 + tolerance)), backbone(4, 3e9))
    spring, other = (found.ranking[0].parameters["k"] for found in (light, moved))
    assert spring.shared_std == pytest.approx(other.value - spring.value, rel=0.15)
    assert spring.shared_std > 0.6 * spring.std


@pytest.mark.parametrize(
    "wrong",
    [[Estimate("a", "", 1.0, 0.1)], [Estimate("a", "", 1.0, 0.0), Estimate("b", "", 1.0, 0.1)],
     [Estimate("a", "", np.nan, 0.1), Estimate("b", "", 1.0, 0.1)]],
)  # fmt: skip
def test_what_cannot_be_compared_is_refused(wrong):
    with pytest.raises(ValueError, match=r"two units|finite value"):
        components(wrong)


def diagnosis(verdict=Verdict.EFFECT, stiffness=1e9, std=2e7, mass=1.0):
    """A diagnosis that names a cubic spring and re-fits a mass."""
    head = Ranked(
        "cubic_stiffness", "point", "3", 0.99, (), {"stiffness_n_m3": Value(stiffness, std, "N/m³")},
        Share(0.9, 0.8, 0.95), stiffness / std,
    )  # fmt: skip
    return Diagnosis(
        verdict, (), (), (head,) if verdict is Verdict.EFFECT else (), {}, None, (),
        (Recalibrated("structure.mass_factor", 1.0, mass, 0.002, "", 0.05, 3.0),), {},
    )  # fmt: skip


def of(*values, **more):
    return [UnitDiagnosis(f"leg {k + 1}", "", diagnosis(stiffness=value, **more)) for k, value in enumerate(values)]


def test_one_effect_and_one_value_for_all():
    group = unit_group(of(1.00e9, 1.01e9, 0.98e9, 1.02e9), "")
    assert group.sentences[0] == "All 4 units: one effect for all, cubic stiffness at point 3."
    assert any("one value for all within its ±" in sentence for sentence in group.sentences)
    assert group.quantities[0].of_effect


def test_the_odd_one_and_the_one_without_the_effect_are_named():
    group = unit_group(of(1.00e9, 1.02e9, 2.5e9, 0.99e9, 1.01e9), "")
    assert any(
        s.startswith("leg 3 differs from its sisters in cubic stiffness at point 3: stiffness_n_m3 by")
        for s in group.sentences
    )
    some = [*of(1.00e9, 1.02e9), UnitDiagnosis("leg 3", "", diagnosis(Verdict.CALIBRATION))]
    sentences = unit_group(some, "").sentences
    assert "2 of 3 units: cubic stiffness at point 3 (leg 1, leg 2)." in sentences
    assert "1 of 3 units: no effect is missing (leg 3)." in sentences


def test_units_that_a_law_tells_and_a_channel_in_another_unit_are_named():
    law = LocalLaw(3, 0, "dry friction", (), 1e-3, (), ())
    reading = LawReading("leg", 5, (law,), 9.0, 1.0, 0.9, 0.9, (), closed_by_file=0.8)
    lawful_one = replace(diagnosis(Verdict.UNKNOWN), law=reading, law_leads=True)
    lawful = [UnitDiagnosis(f"leg {k}", "", lawful_one) for k in (1, 2)]
    words = "a force like dry friction (point 3), which no effect of the library explains"
    assert unit_group(lawful, "").sentences[0] == f"All 2 units: one force for all, {words}."
    sentence = "leg_3: f1 is 4.45 times what the model predicts: lbf?"
    turned = replace(diagnosis(Verdict.UNKNOWN), sentences=(sentence, UNITS_FIRST))
    group = unit_group([*lawful, UnitDiagnosis("leg 3", "", turned)], "")
    assert f"2 of 3 units: {words} (leg 1, leg 2)." in group.sentences
    assert "1 of 3 units: a channel has another unit or sign than the model predicts (leg 3)." in group.sentences
    assert f"leg 3: {sentence}" in group.sentences
    assert "known cause" not in " ".join(group.sentences)
    assert "another unit or sign" in group_page("leg", "a leg", group, [])


def test_scatter_of_mounting_is_compared_with_the_effect():
    values = {"leg 1": (1.0e8, 9.0e8, 2.0e8), "leg 2": (8.0e8, 1.5e8, 3.0e8), "leg 3": (9.5e8, 1.2e8, 0.2e8)}
    group = unit_group(
        [
            UnitDiagnosis(unit, f"mounting {k + 1}", diagnosis(stiffness=value, std=1e6))
            for unit, each in values.items()
            for k, value in enumerate(each)
        ],
        "mounting",
    )
    assert any(
        "the scatter of re-mounting is larger than that between units" in sentence
        or "the scatter of re-mounting is larger than the effect" in sentence
        for sentence in group.sentences
    )
    page = group_page("leg", "a leg", group, [("leg 1", "1-leg-1/report.html")])
    assert "stiffness_n_m3" in page
    assert "within a unit" in page
    assert 'href="1-leg-1/report.html"' in page


def test_a_table_of_units_is_read(tmp_path):
    for name in ("a", "b", "c", "d"):
        (tmp_path / name).mkdir()
    (tmp_path / "units.csv").write_text("recording,unit,mounting\na,leg 1,1\nb,leg 1,2\nc,leg 2,1\nd,leg 2,1\n")
    rows, varied = read_unit_table(tmp_path / "units.csv")
    assert varied == "mounting"
    assert [(row.unit, row.setting, len(row.recordings)) for row in rows] == [
        ("leg 1", "mounting 1", 1), ("leg 1", "mounting 2", 1), ("leg 2", "mounting 1", 2),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the first line must name"),
        ("recording,leg\n", "the first line must name"),
        ("recording,unit\na,leg 1\n", "two units or more"),
        ("recording,unit\nnowhere,leg 1\n", "line 2: it needs a unit and a recording that is there"),
        ("recording,unit\na\n", "1 cells for 2 columns"),
    ],
)
def test_tables_that_are_wrong_are_named(tmp_path, text, says):
    (tmp_path / "a").mkdir()
    (tmp_path / "units.csv").write_text(text)
    with pytest.raises(BenchError, match=says):
        read_unit_table(tmp_path / "units.csv")
