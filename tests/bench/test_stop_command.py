"""``stop`` says that all is at rest only if every bench that answered says so."""

from __future__ import annotations

import pytest

from nmt_bench import cli
from nmt_core.messages.records import DriveStop
from nmt_core.vocabulary import OutputState, StopCause

bench_domain = pytest.importorskip("nmt_bench.orchestration.bench_domain")
stop_node = pytest.importorskip("nmt_bench.orchestration.stop_node")

HELD, ENDED, RAMPING, UNKNOWN = OutputState.HELD, OutputState.ENDED, OutputState.RAMPING, OutputState.NOT_KNOWN


@pytest.mark.parametrize(
    ("outputs", "code"),
    [([HELD, ENDED], 0), ([HELD, None], 0), ([HELD, RAMPING], 1), ([UNKNOWN, HELD], 1), ([None, None], 1)],
)
def test_exit_code(outputs, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    answers = {
        domain: None if output is None else DriveStop(9, StopCause.EMERGENCY_STOP, output, "asked for")
        for domain, output in zip((41, 42), outputs, strict=True)
    }
    monkeypatch.setattr(bench_domain, "domains_in_use", lambda: [41, 42])
    monkeypatch.setenv("ROS_DOMAIN_ID", "41")
    monkeypatch.setattr(stop_node, "send_stop", lambda domain, *_: answers[domain])
    assert cli.main(["stop"]) == code
    assert capsys.readouterr().out.count("the drive is held at zero") == outputs.count(HELD)
