"""A laboratory's measuring chain is healthy, lies on top of what is true, and does to a signal what it says."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from blind.blind_campaign import make, operating, short_rig

from nmt_blind.cases.blind_rigs import blind_rig
from nmt_blind.cases.draw import draw_cases
from nmt_blind.cases.laboratory import record_backbone
from nmt_blind.cases.laboratory_rig import STEPS, STEPS_OF_IMAGES, Converters, LaboratoryRig
from nmt_blind.cases.rig_edits import Edit, with_edits
from nmt_blind.cases.tolerances import check_tolerances, draw_chain
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import OscillatorPhase
from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.observations.channels.measuring_chain import measuring_chain
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.oscillator import OscillatorBlock
from nmt_record.bag.bag_reader import Bag

MODAL = blind_rig("modal_beam").model()
# Of the sensors of the modal beam, s.
_DELAYS = (-0.9 / 5000.0, 0.4 / 5000.0, 2.3 / 5000.0, -0.5 / 5000.0, 0.0, 0.0)
RIG = short_rig()
MODEL = RIG.model()


def test_a_chain_is_what_an_ordinary_laboratory_has() -> None:
    chains = [draw_chain(MODEL, operating(), np.random.default_rng(seed)) for seed in range(400)]
    gains = np.array([chain.gains for chain in chains]) - 1.0
    assert gains.std() == pytest.approx(TOLERANCES.gain, rel=0.1)
    assert abs(gains.mean()) < 5e-4
    leads = np.degrees([chain.leads for chain in chains])
    shaky = [s.quantity in ("force", "acceleration") for s in MODEL.sensors]
    assert np.sqrt((leads[:, shaky] ** 2).mean()) == pytest.approx(TOLERANCES.phase_deg, rel=0.1)
    assert not leads[:, ~np.array(shaky)].any()  # what measures constants has no high-pass
    delays = np.array([chain.delays for chain in chains])
    voltage = [s.quantity == "voltage" for s in MODEL.sensors].index(True)
    assert not delays[:, voltage].any()
    # Sensors of a kind share a delay of their own.
    means = []
    for quantity in {s.quantity for s in MODEL.sensors} - {"voltage"}:
        group = delays[:, [s.quantity == quantity for s in MODEL.sensors]]
        means.append(group.mean(axis=1))
        assert means[-1].std() == pytest.approx(TOLERANCES.shared_delay_s / math.sqrt(3.0), rel=0.1)
        spread = (group - group.mean(axis=1, keepdims=True)).std() / TOLERANCES.delay_s
        assert 0.5 < spread < 1.1 if group.shape[1] > 1 else spread == 0.0
    assert np.abs(np.corrcoef(means) - np.eye(len(means))).max() < 0.2
    hums = np.array([chain.hums[1] for chain in chains]) / operating().channels["x2"]
    assert 0.0 <= hums.min() < hums.max() <= TOLERANCES.mains
    assert all(abs(size) <= TOLERANCES.drive_harmonic for chain in chains for _, size in chain.converters.harmonics)
    with pytest.raises(BenchError, match="no tolerances 'tight'"):
        check_tolerances("tight")


def test_a_chain_lies_on_top_of_what_is_true() -> None:
    chain = draw_chain(MODEL, operating(), np.random.default_rng(3))
    truth = with_edits(
        MODEL,
        (
            Edit(("sensors", 1, "gain"), 1.05),
            Edit(("sensors", 1, "delay_s"), 3e-4),
            Edit(("sensors", 0, "high_pass_hz"), 2.0),
            Edit(("clock_error",), 1e-3),
        ),
    )
    found = with_edits(truth, chain.edits(truth, 139.0))
    assert found.sensors[1].gain == pytest.approx(1.05 * chain.gains[1])
    assert found.sensors[1].delay_s == pytest.approx(3e-4 + chain.delays[1])
    assert found.sensors[0].high_pass_hz == 2.0
    lead = math.atan(found.sensors[5].high_pass_hz * 2.0 * math.pi / 139.0)
    assert lead == pytest.approx(chain.leads[5])
    assert found.clock_error == pytest.approx(1e-3 + chain.clock)


def _started(device: SimulatedRig) -> SimulatedRig:
    device.configure()
    device.start()
    return device


def _block(first: int, samples: int, frequency: float, amplitude: float) -> OscillatorBlock:
    rate = MODAL.sample_rate_hz
    cycles = (frequency * first / rate) % 1.0
    phase = OscillatorPhase(cycles, frequency, 0.0)
    return OscillatorBlock(amplitude * np.cos(phase.phase(samples + 1, rate))[None], phase)


def _amplitudes(device: SimulatedRig, frequency: float, orders: tuple[int, ...]) -> np.ndarray:
    """Harmonics of every channel after the motion has settled, before the sensors, in the frame of the drive."""
    parts = [device._measure(_block(first, 5000, frequency, 0.1)) for first in range(0, 50_000, 5000)]
    data = parts[-1]
    angle = 2.0 * np.pi * frequency * (45_000 + np.arange(5000)) / MODAL.sample_rate_hz
    return np.array([2.0 * (data * np.exp(-1j * order * angle)).mean(axis=1) for order in orders])


def test_the_drive_is_held_and_distorted_as_drawn() -> None:
    frequency = 100.0
    plain, straight, held, smooth, rough = (
        _amplitudes(_started(device), frequency, (1, 3))
        for device in (
            SimulatedRig(MODAL.model_copy(update={"substeps": STEPS})),
            LaboratoryRig(MODAL, Converters()),
            LaboratoryRig(MODAL, Converters(held=True)),
            LaboratoryRig(MODAL, Converters(held=True, filtered=True)),
            LaboratoryRig(MODAL, Converters(harmonics=((3, 1e-3j),))),
        )
    )
    np.testing.assert_allclose(straight[0], plain[0], rtol=1e-9)
    # Held over all but the last step of a sample: late by half of that. The reference is straight between samples,
    # which takes sinc² from it.
    x = 2.0 * np.pi * frequency / MODAL.sample_rate_hz
    step = 1.0 / STEPS_OF_IMAGES
    late = np.sinc(x * step / (2.0 * np.pi)) / np.sinc(x / (2.0 * np.pi)) * np.exp(-0.5j * x * (1.0 - step))
    moved = [row for row, sensor in enumerate(MODAL.sensors) if sensor.quantity == "displacement"]
    np.testing.assert_allclose(held[0][moved] / plain[0][moved], late, rtol=2e-4)
    # Without a filter the steps appear in what follows them at once: force and acceleration. With one they do not,
    # and all channels are late alike.
    voltage = [row for row, sensor in enumerate(MODAL.sensors) if sensor.quantity == "voltage"]
    jumps = [row for row, sensor in enumerate(MODAL.sensors) if sensor.quantity in ("force", "acceleration")]
    assert np.abs(held[0][jumps] / plain[0][jumps] / late - 1.0).max() > 1e-3
    apart = smooth[0] / smooth[0][voltage]
    straightened = np.sinc(x / (2.0 * np.pi)) ** 2
    np.testing.assert_allclose(apart[moved], plain[0][moved] / plain[0][voltage] / straightened, rtol=2e-4)
    still = plain[0][jumps] / plain[0][voltage] / straightened
    assert np.abs(apart[jumps] / still - 1.0).max() < 0.05 * np.abs(held[0][jumps] / plain[0][jumps] / late - 1.0).max()
    np.testing.assert_allclose(rough[1][voltage], 1e-4j, rtol=1e-6)
    np.testing.assert_allclose(rough[0][voltage], 0.1, rtol=1e-9)


def test_channels_lead_and_lag_by_what_they_should_far_up_too() -> None:
    """At a fifth of the sample rate, where six samples say little of what is between them."""
    frequency, lead = 1000.0, 0.9 / MODAL.sample_rate_hz
    moved = [s.model_copy(update={"delay_s": delay}) for s, delay in zip(MODAL.sensors, _DELAYS, strict=True)]
    prompt, apart = (
        _amplitudes(_started(LaboratoryRig(rig, Converters(held=True, filtered=True))), frequency, (1,))[0]
        for rig in (MODAL, MODAL.model_copy(update={"sensors": moved}))
    )
    assert min(_DELAYS) == -lead
    expected = np.exp(-2j * np.pi * frequency * np.array(_DELAYS))
    # The filter leaves some 0.3 % of the image at four fifths of the sample rate.
    np.testing.assert_allclose(apart / prompt, expected, rtol=3e-3)


def test_a_bag_with_tolerances_says_that_it_comes_from_elsewhere(tmp_path: Path) -> None:
    model = MODEL
    for name, converters in (("lab", Converters(True)), ("own", None)):
        record_backbone(tmp_path / name, model, model, RIG.bench, 5, converters)
    lab, own = (Bag.open(tmp_path / name).run_start for name in ("lab", "own"))
    assert measuring_chain(own, {}, 4000.0) is None
    found = measuring_chain(lab, {}, 4000.0)
    assert found is not None
    assert found.hold_hz == 4000.0
    assert {key: value for key, value in lab.items() if key != "imported"} == own


def test_every_case_has_a_chain_of_its_own_and_the_bags_say_nothing_of_it(tmp_path: Path) -> None:
    cases = draw_cases(MODEL, operating(), 20, 6, tolerances="laboratory")
    plain = draw_cases(MODEL, operating(), 20, 6)
    for with_chain, without in zip(cases, plain, strict=True):
        assert with_chain.edits[: len(without.edits)] == without.edits
        assert replace(with_chain, edits=without.edits, converters=None) == without
    gains = {edit.value for case in cases for edit in case.edits if edit.path == ("sensors", 2, "gain")}
    assert len(gains) >= 20
    made = make(tmp_path / "a", count=1, tolerances="laboratory")
    other = make(tmp_path / "b", count=1, tolerances="none")
    assert made.seal != other.seal
    runs = [Bag.open(tmp_path / "a/cases/0001" / test).run_start for test in ("backbone", "random")]
    assert runs[0]["imported"] == runs[1]["imported"]
