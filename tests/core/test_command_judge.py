"""Judge of incoming commands: what cannot be meant is refused, counted and named; what can be is taken."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.command_judge import CommandJudge, CommandSource, Refusal

BLOCK, HORIZON = 200, 100_000


def fresh(**options: int) -> CommandJudge:
    return CommandJudge(BLOCK, HORIZON, **options)


def test_an_ordinary_run_is_taken_whole() -> None:
    judge = fresh()
    for n in range(1, 500):
        assert (
            judge.judge(
                "pll", next_sample=n * BLOCK, based_on=n * BLOCK - 1, apply_at=n * BLOCK, values={"frequency_hz": 22.0}
            )
            == ""
        )
    assert judge.counts == {"accepted": 499, "missing_blocks": 0}
    assert judge.latest == ""


@pytest.mark.parametrize(
    ("message", "kind", "words"),
    [
        ({"based_on": 2**60}, Refusal.NOT_MEASURED, "has not been measured; the next sample is 1000"),
        ({"based_on": 1000}, Refusal.NOT_MEASURED, "has not been measured"),
        ({"based_on": 998}, Refusal.NOT_A_BLOCK, "not the last of a block of 200"),
        ({"based_on": 799}, Refusal.REPEATED, "sample 799 was answered before"),
        ({"based_on": 599}, Refusal.REPEATED, "sample 799 was answered before"),
        ({"based_on": 999, "apply_at": 2**60}, Refusal.AHEAD, "more than 100000 samples ahead of sample 1000"),
        ({"based_on": 999, "apply_at": 101_001}, Refusal.AHEAD, "ahead of sample 1000"),
        ({"based_on": 999, "values": {"ramp": math.nan}}, Refusal.NOT_FINITE, "its ramp is nan"),
        ({"based_on": 999, "values": {"a": 1.0, "amplitude": math.inf}}, Refusal.NOT_FINITE, "its amplitude is inf"),
    ],
)
def test_what_cannot_be_meant_is_refused_and_changes_nothing(message, kind, words) -> None:
    judge = fresh()
    assert judge.judge("pll", next_sample=800, based_on=799) == ""
    assert words in judge.judge("pll", next_sample=1000, **message)
    assert judge.latest
    assert judge.counts == {"accepted": 1, "missing_blocks": 0, f"refused_{kind.value}": 1}
    assert judge.last == 799
    assert judge.judge("pll", next_sample=1000, based_on=999, apply_at=101_000) == ""


def test_left_out_blocks_are_counted_and_bounded() -> None:
    judge = fresh(most_missing=2)
    assert judge.judge("pll", next_sample=10_000, based_on=199) == ""
    assert judge.judge("pll", next_sample=10_000, based_on=799) == ""
    assert judge.missing == 2
    assert "3 blocks were left out, 2 are allowed" in judge.judge("pll", next_sample=10_000, based_on=1599)
    assert judge.refused[Refusal.GAP] == 1
    assert judge.judge("pll", next_sample=10_000, based_on=999) == ""
    assert judge.missing == 2


def test_one_source_until_it_is_released() -> None:
    judge = fresh()
    assert "has not been measured" in judge.judge("stranger", next_sample=200, based_on=2**60)
    assert judge.source is None, "a message that is refused binds nobody"
    assert judge.judge("pll", next_sample=200, based_on=199) == ""
    for _ in range(30_000):
        assert "second source, stranger; the one accepted is pll" in judge.judge(
            "stranger", next_sample=400, based_on=399
        )
    assert judge.strangers == {"stranger": 30_000}
    assert judge.judge("pll", next_sample=400, based_on=399) == ""
    judge.release()
    assert judge.judge("next pll", next_sample=200, based_on=199) == ""


def test_a_named_source_is_the_only_one_from_the_beginning() -> None:
    judge = CommandJudge(BLOCK, HORIZON, source="pll")
    assert judge.judge("stranger", next_sample=200, based_on=199) != ""
    assert judge.judge("pll", next_sample=200, based_on=199) == ""


def test_strangers_without_number_do_not_fill_the_memory() -> None:
    judge = CommandJudge(BLOCK, HORIZON, source="pll")
    for token in range(5000):
        judge.judge(token, next_sample=200, based_on=199)
    assert judge.refused[Refusal.SOURCE] == 5000
    assert len(judge.strangers) == 100


def test_without_samples_of_its_own_the_last_accepted_message_is_the_present() -> None:
    """As for the loop's state at the sequencer, which reads no samples."""
    judge = fresh(most_missing=1000)
    assert "ahead of sample 0" in judge.judge("pll", based_on=2**60 - 1)
    assert judge.judge("pll", based_on=199) == ""
    assert "more than 100000 samples ahead of sample 199" in judge.judge("pll", based_on=2**60 - 1)
    assert judge.judge("pll", based_on=399, apply_at=100_199) == ""


def test_a_released_judge_still_knows_the_present_sample() -> None:
    """The next run on the same nodes begins where the one before has ended, however late that is."""
    judge = fresh()
    for n in range(1, 2000):
        assert judge.judge("pll", based_on=n * BLOCK - 1) == ""
    judge.release()
    present = 1999 * BLOCK - 1
    assert f"ahead of sample {present}" in judge.judge("pll", based_on=present + 501 * BLOCK)
    assert judge.judge("next pll", based_on=present + 2 * BLOCK, apply_at=present + HORIZON) == ""


def test_a_random_storm_moves_an_accepted_run_by_nothing() -> None:
    """Whatever is thrown in between, the accepted sequence is the one that was sent."""
    rng = np.random.default_rng(8)
    judge = fresh()
    taken = []
    for n in range(1, 300):
        now = n * BLOCK
        for _ in range(int(rng.integers(0, 5))):
            noise = {
                "based_on": int(rng.choice([0, 1, now - 1, now, now + 199, 2**60, 2**64 - 1, now - 1 - BLOCK])),
                "apply_at": int(rng.choice([0, now, 2**60])),
                "values": {"amplitude": float(rng.choice([0.1, math.nan, math.inf]))},
            }
            source = str(rng.choice(["stranger", "pll"])) if n > 1 else "stranger"
            answer = judge.judge(source, next_sample=now, **noise)
            sound = (
                noise["based_on"] == now - 1
                and noise["apply_at"] <= now
                and math.isfinite(noise["values"]["amplitude"])
            )
            if source == "pll" and sound and judge.last == now - 1 and answer == "":
                taken.append(now - 1)
        if judge.judge("pll", next_sample=now, based_on=now - 1) == "":
            taken.append(now - 1)
        if n == 1 and judge.source == "stranger":
            judge.release()
            taken.clear()
            assert judge.judge("pll", next_sample=now, based_on=now - 1) == ""
            taken.append(now - 1)
    assert taken == [n * BLOCK - 1 for n in range(1, 300)]
    assert judge.missing == 0


@pytest.mark.parametrize("options", [{"block_samples": 0}, {"horizon": 0}, {"most_missing": -1}])
def test_a_judge_needs_sensible_numbers(options: dict[str, int]) -> None:
    with pytest.raises(BenchError, match="command judge"):
        CommandJudge(**{"block_samples": 1, "horizon": 1, **options})


def test_of_a_topic_with_two_publishers_nothing_is_taken() -> None:
    judge = fresh()
    both = CommandSource("gid", "/pll", alone=False)
    assert "several publishers, /pll" in judge.judge(both, next_sample=200, based_on=199)
    assert judge.counts["refused_second_source"] == 1
    assert judge.last is None
    assert judge.judge(CommandSource("gid", "/pll"), next_sample=200, based_on=199) == ""
