"""The model's backbone for the page, computed by a process of its own at the lowest priority."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from nmt_bench.page.live_view import LiveView
from nmt_core.errors import BenchError
from nmt_report.run_data import read_reference

_PATIENCE = 300.0  # s


async def show_reference(rig_file: Path, view: LiveView) -> bool:
    """Compute the backbone of a rig file and show it; False where the rig has no such model."""
    with tempfile.TemporaryDirectory(prefix="nmt-page-") as folder:
        out = Path(folder) / "reference"
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "nmt_bench", "reference", str(rig_file), "--out", str(out), "--harmonics", "9",
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
            preexec_fn=lambda: os.nice(19),
        )  # fmt: skip
        try:
            await asyncio.wait_for(process.wait(), _PATIENCE)
        except asyncio.TimeoutError:
            return False
        finally:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()
        try:
            curve = read_reference(out / "reference.csv")
        except BenchError:
            return False
        view.set_reference(curve.modal_amplitude, curve.omega_rad_s / (2.0 * np.pi), curve.damping_ratio)
    return True
