"""No first diagnosis waits for a compiler: the warm-up uses the kernels that take long to compile."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from nmt_diagnose.measurements import locked_prediction as locked_windows
from nmt_diagnose.measurements import random_responses, recorded_decay, stepped_responses
from nmt_diagnose.prediction import record_kernel
from nmt_diagnose.prediction.warm_up import warm_up_predictions
from nmt_rig.rig import load_rig

# The kernels that the modules of the prediction call; what those call in turn compiles with them.
KERNELS = [
    (locked_windows, "newton"),
    (locked_windows, "advance"),
    (random_responses, "linear_responses"),
    (random_responses, "sensor_gains"),
    (random_responses, "windowed"),
    (stepped_responses, "solve_lines"),
    (stepped_responses, "advance"),
    (recorded_decay, "newton"),
    (recorded_decay, "stepped"),
    (recorded_decay, "observed_ratios"),
    (record_kernel, "_step_all"),
    (record_kernel, "_step_one"),
]


@pytest.mark.parametrize(
    ("module", "name"), KERNELS, ids=[f"{module.__name__.rpartition('.')[2]}.{name}" for module, name in KERNELS]
)
def test_the_warm_up_uses_a_kernel(module: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel: Callable[..., Any] = getattr(module, name)
    calls = []

    def counted(*values: Any) -> Any:
        calls.append(values)
        return kernel(*values)

    monkeypatch.setattr(module, name, counted)
    for records in (False, True):
        warm_up_predictions(load_rig("beam"), records)
    assert calls
