"""Tables of several points that were measured in one passage are one test, with one motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.stepped_reading import measured_together
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_tables import table_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

LINES = np.linspace(45.0, 55.0, 30)


def rig() -> Rig:
    mode = {"frequency_hz": 50.0, "damping_ratio": 0.01, "shape": [1.0, 0.5, -0.3]}
    structure = {"kind": "modal", "points": [1, 2, 3], "modes": [mode]}
    return validate_rig(RigDocument("test", {"name": "three", "structure": structure}, {}))


def table(
    point: int, noise: float = 0.01, level: float = 2.0, direction: str = "up", lines: np.ndarray = LINES
) -> ObservableTable:
    omega, natural = 2.0 * np.pi * lines, 2.0 * np.pi * 50.0
    share = {1: 1.0, 2: 0.5, 3: -0.3}.get(point, 1.0)
    response = -share * omega**2 / (natural**2 - omega**2 + 0.02j * natural * omega)
    return ObservableTable(
        TableKind.FRF, {"frequency_hz": lines, "real": response.real, "imag": response.imag}, {}, Quantity.ACCELERATION,
        level=level, level_unit="N", point=point, drive_point=1, name=f"p{point}", direction=direction, noise=noise,
    )  # fmt: skip


def test_points_of_one_passage_are_together() -> None:
    tables = [table(1), table(2), table(1, level=5.0), table(3), table(2, direction="down"), table(2, level=5.0)]
    assert measured_together(tables, 1) == [[0, 1, 3], [2, 5], [4]]


def test_what_is_no_passage_of_its_own_stands_alone() -> None:
    twice = [table(1), table(1), table(2)]
    assert measured_together(twice, 1) == [[0], [1, 2]]
    assert measured_together([table(1), table(2, lines=LINES + 0.1)], 1) == [[0], [1]]
    held = [replace(table(point), level_unit="m/s^2") for point in (1, 2)]
    assert measured_together(held, 1) == [[0], [1]], "each says how large its own point moved"
    unfit = [replace(table(point), held="base") for point in (1, 2)]
    assert measured_together(unfit, 1) == [[0], [1]]
    backbones = [ObservableTable(TableKind.BACKBONE, {"frequency_hz": LINES, "amplitude": LINES}, {})] * 2
    assert measured_together(backbones, 1) == [[0], [1]]
    other_drive = [table(1), replace(table(2), drive_point=2)]
    assert measured_together(other_drive, 1) == [[0], [1]]
    assert measured_together([replace(table(1), drive_point=0), table(2)], 1) == [[0, 1]]


def test_one_test_has_the_rows_of_all_and_the_motion_of_the_best() -> None:
    tables = [table(2, noise=0.02), table(1, noise=0.005), table(3, noise=0.03)]
    settings = ObservationSettings()
    together = table_observations("all", tables, rig(), settings)
    (test,) = together.tests
    assert [channel.point for channel in test.channels] == [1, 2, 3]
    for k, own in enumerate([tables[1], tables[0], tables[2]]):
        alone = table_observations("one", [own], rig(), settings)
        for part in (Part.LOG_MAGNITUDE, Part.PHASE):
            mine = (together.rows.channel == k) & (together.rows.part == part)
            its = alone.rows.part == part
            assert together.values[mine] == pytest.approx(alone.values[its])
            assert together.std[mine] == pytest.approx(own.noise)


def test_a_point_that_the_model_lacks_is_left_out_alone() -> None:
    found = table_observations("all", [table(1), table(7), table(2)], rig(), ObservationSettings())
    assert [channel.point for channel in found.tests[0].channels] == [1, 2]
    assert any("point 7 is not among" in note for note in found.notes)
    none = table_observations("all", [table(7)], rig(), ObservationSettings())
    assert not none.tests


@pytest.mark.parametrize(
    ("reference", "exciter"),
    [
        ("force", {"kind": "force", "point": 1, "newton_per_volt": 5.0}),
        ("voltage", {"kind": "force", "point": 1, "newton_per_volt": 5.0}),
        ("base", {"kind": "shaking_table", "point": 1, "acceleration_per_volt_m_s2": 4.0}),
        ("base", {"kind": "shaking_table", "point": 1, "acceleration_per_volt_m_s2": 4.0, "responses": "absolute"}),
    ],
)
def test_responses_without_a_level_are_over_what_they_were_divided_by(
    reference: str, exciter: dict[str, object]
) -> None:
    mode = {"frequency_hz": 50.0, "damping_ratio": 0.01, "modal_mass_kg": 1.6}
    if reference == "base":
        mode["participation"] = 1.0
    words = {"name": "one", "structure": {"kind": "modal", "modes": [mode]}, "exciter": exciter}
    model = validate_rig(RigDocument("test", words, {}))
    omega, natural = 2.0 * np.pi * LINES, 2.0 * np.pi * 50.0
    below = natural**2 - omega**2 + 0.02j * natural * omega
    response = {"force": -(omega**2) / below / 1.6, "voltage": -5.0 * omega**2 / below / 1.6, "base": omega**2 / below}[
        reference
    ]
    if exciter.get("responses") == "absolute":
        response = 1.0 + response
    columns = {"frequency_hz": LINES, "real": response.real, "imag": response.imag}
    given = ObservableTable(
        TableKind.FRF, columns, {}, Quantity.ACCELERATION, point=1, drive_point=1, name="p1", reference=reference
    )
    found = table_observations("one", [given], model, ObservationSettings())
    predicted = Forward(found.tests, found.rows).predict(model).values
    assert found.tests[0].lines.reference == reference
    assert Forward(found.tests, found.rows).difference(found.values, predicted) == pytest.approx(0.0, abs=2e-3)
    if reference == "base":
        still = validate_rig(RigDocument("test", {**words, "exciter": {"kind": "force", "point": 1}}, {}))
        with pytest.raises(BenchError, match="not a shaking table; write exciter"):
            table_observations("one", [given], still, ObservationSettings())
