"""Five hundred hostile inputs over every kind of file the bench reads: a sentence each, in time and in bounds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path


def test_hostile_inputs_get_a_sentence_each(tmp_path: Path) -> None:
    script = Path(__file__).with_name("hostile_inputs.py")
    paths = os.pathsep.join(path for path in sys.path if path)
    ended = subprocess.run(
        [sys.executable, str(script), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout.splitlines()[-1])
    assert found["count"] >= 500
    assert found["refused"] > found["count"] / 2
    assert found["traces"] == []
    assert found["slow"] == []
    assert found["peak"] < 1e9
