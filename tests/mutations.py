"""Single-line mutations of physics, safety and contracts: does the first tier notice each of them?

    ./nmt shell <<< "python tests/mutations.py"
    ./nmt shell <<< "python tests/mutations.py --of nmt_plant --again"

Each is applied alone to a copy of the sources, in which the first tier then runs until something fails: the tests that
import the mutated module first, then those of its package, then, unless ``--near`` is given, all others. Results are
kept in ``.nmt/mutations.json`` as long as the file and the tests of the package are the same, so that the command goes
on where it stopped. Tests that start ``./nmt`` itself see what is set up, not the copy.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / ".nmt" / "mutations.json"
COPY = ROOT / ".nmt" / "mutated"
LONGEST = 900.0  # s of wall time of one run of pytest
# Tests of a package beside those in the folder of its name.
FOLDERS = {
    "nmt": ["tests/analysis"],
    "nmt_msgs": ["tests/core", "tests/record", "tests/node/test_wire.py"],
    "nmt_diagnose": ["tests/diagnose"],
}


@dataclass(frozen=True)
class Mutation:
    """One changed line.

    Attributes:
        file: below ``ros2_ws/src`` or ``campaigns``.
        old, new: text before and after; the first stands exactly once in the file.
        breaks: what is wrong then.
    """

    file: str
    old: str
    new: str
    breaks: str

    @property
    def package(self) -> str:
        """Name of the package."""
        return self.file.partition("/")[0]


MUTATIONS = [
    Mutation(*row)
    for row in [
        (
            "nmt_core/nmt_core/numerics/ramp.py",
            "0.5 - 0.5 * np.cos(np.pi * np.clip",
            "0.5 - 0.5 * np.cos(0.5 * np.pi * np.clip",
            "a ramp ends at half of its target, with a step",
        ),
        (
            "nmt_core/nmt_core/messages/command_judge.py",
            "based_on >= next_sample",
            "based_on > next_sample",
            "a command may claim to know the sample that comes next",
        ),
        (
            "nmt_core/nmt_core/messages/command_judge.py",
            "if isinstance(source, CommandSource) and not source.alone:",
            "if isinstance(source, CommandSource) and source.alone:",
            "commands are taken from a topic with two publishers",
        ),
        (
            "nmt_rig/nmt_rig/model/assembly.py",
            "damping[current, coil] = shaker.force_factor",
            "damping[current, coil] = -shaker.force_factor",
            "the back-EMF drives the current",
        ),
        (
            "nmt_rig/nmt_rig/model/local_elements/iwan.py",
            "* (1.0 + self.stiffness_ratio)\n",
            "* (1.0 - self.stiffness_ratio)\n",
            "the slip force of a joint with sliders at the end",
        ),
        (
            "nmt_rig/nmt_rig/model/integration_kernel.py",
            "memory.dissipated[e] += side * parameters[e, SLIP_FORCE] * (after - before)",
            "memory.dissipated[e] -= side * parameters[e, SLIP_FORCE] * (after - before)",
            "friction creates energy",
        ),
        (
            "nmt_plant/nmt_plant/safety/limits.py",
            "        if peak > levels[0, row]:",
            "        if peak > 2.0 * levels[0, row]:",
            "a limit trips at twice its level",
        ),
        (
            "nmt_plant/nmt_plant/safety/limits.py",
            "peak = magnitude if magnitude == magnitude else np.inf",
            "peak = magnitude if magnitude == magnitude else 0.0",
            "a channel that delivers no numbers trips no limit",
        ),
        (
            "nmt_plant/nmt_plant/safety/watchdog.py",
            "return 0 < self.blocks <= self.missed",
            "return 0 < self.blocks < self.missed",
            "the watchdog is a block late",
        ),
        (
            "nmt_plant/nmt_plant/safety/output_guard.py",
            "length = round(min(ramp * self._sample_rate, 1e9))",
            "length = round(min(10.0 * ramp * self._sample_rate, 1e9))",
            "the output goes to zero ten times as slowly",
        ),
        (
            "nmt_pll/nmt_pll/detection/phase_detector.py",
            "turned = response * force.conjugate() * cmath.rect(1.0, velocity_lead)",
            "turned = response.conjugate() * force * cmath.rect(1.0, velocity_lead)",
            "the sign of the phase error",
        ),
        (
            "nmt_pll/nmt_pll/phase_loop/gains.py",
            "real_part = -(d + 1.0) / 3.0",
            "real_part = -(d + 1.0) / 2.0",
            "the three poles of the loop do not fall together",
        ),
        (
            "nmt_pll/nmt_pll/detection/lock.py",
            "mean_std=noise * math.sqrt(self._inflation / self.length),",
            "mean_std=noise / math.sqrt(self._inflation * self.length),",
            "correlated values of the dwell count as independent",
        ),
        (
            "nmt_sequencer/nmt_sequencer/run_machine.py",
            "record.index != level_index or not record.started <= sample < window_end",
            "record.index != level_index or not sample < window_end",
            "a stale lock event is accepted",
        ),
        (
            "nmt_sequencer/nmt_sequencer/run_machine.py",
            "return record.window_end is not None and end >= record.window_end",
            "return record.window_end is not None and end >= record.window_end - 1000",
            "a level that is cut short counts as complete",
        ),
        (
            "nmt_sequencer/nmt_sequencer/level_plan.py",
            "return up + up[-2::-1]",
            "return up + up[::-1]",
            "the turning level twice",
        ),
        (
            "nmt_record/nmt_record/bag/gap_counter.py",
            "state.missing_samples += missing",
            "state.missing_samples += 1",
            "lost samples are counted as one",
        ),
        (
            "nmt_record/nmt_record/bag/gap_counter.py",
            "return all(state.next_sample > sample for",
            "return any(state.next_sample > sample for",
            "a bag is closed before all its topics have come",
        ),
        (
            "nmt_record/nmt_record/exchange/unit_table.py",
            "STANDARD_GRAVITY = 9.80665",
            "STANDARD_GRAVITY = 9.81",
            "accelerations in g are 0.03 % off",
        ),
        (
            "nmt_extract/nmt_extract/linear/identification.py",
            "slopes[row, 0] += shapes[row] * (0.5 - powers[row] + 0.5 * powers[drives[strongest]]) / eigenvalue",
            "slopes[row, 0] -= shapes[row] * (0.5 - powers[row] + 0.5 * powers[drives[strongest]]) / eigenvalue",
            "the sign of the slope in the uncertainty of the shapes",
        ),
        (
            "nmt_extract/nmt_extract/modal/quantities.py",
            "np.asarray(0.5 * (self.velocity * self.force.conj())",
            "np.asarray((self.velocity * self.force.conj())",
            "twice the active power",
        ),
        (
            "nmt_extract/nmt_extract/modal/power_balance.py",
            "local = 2.0 * power / (response * amplitude) ** 2 - growth",
            "local = 2.0 * power / (response * amplitude) ** 2 + growth",
            "damping along a ramp has the wrong share of the growth",
        ),
        (
            "nmt_extract/nmt_extract/judgement/uncertainty.py",
            "return math.sqrt(float((residual * residual).sum()) / (count - 2) / spread)",
            "return math.sqrt(float((residual * residual).sum()) / count / spread)",
            "too small an uncertainty of a slope",
        ),
        (
            "nmt_session/nmt_session/node_plan.py",
            'values.setdefault("voltage_limit", float(test.rig.limits.voltage_v))',
            'values.setdefault("voltage_limit", 10.0 * float(test.rig.limits.voltage_v))',
            "the loop may ask for ten times the rig's voltage",
        ),
        (
            "nmt_session/nmt_session/block_length.py",
            "if share <= _SHARE:",
            "if share >= _SHARE:",
            "blocks that lengthen the test are chosen",
        ),
        (
            "nmt_diagnose/nmt_diagnose/observations/observation_settings.py",
            "return self.phase_error * math.sqrt(levels)",
            "return self.phase_error",
            "the floor of the phase is averaged away by many levels",
        ),
        (
            "nmt_diagnose/nmt_diagnose/observations/noise/floors.py",
            "excess = float(np.mean(0.5 * difference[selected] ** 2) - np.mean(stated[selected]))",
            "excess = float(np.mean(difference[selected] ** 2) - np.mean(stated[selected]))",
            "the floor from repeats is √2 too large",
        ),
        (
            "nmt_diagnose/nmt_diagnose/fit/fitting.py",
            "log_evidence = -0.5 * cost - 0.5 * (chain.log_determinant",
            "log_evidence = -0.5 * cost + 0.5 * (chain.log_determinant",
            "more parameters make a model more probable",
        ),
        (
            "nmt_diagnose/nmt_diagnose/fit/noise.py",
            "student = total * np.log1p(beyond / nu)",
            "student = total * np.log1p(beyond / total)",
            "the marginal of a scale is wrong",
        ),
        (
            "nmt_diagnose/nmt_diagnose/chain/chain_columns.py",
            "np.where(selected, level.phase_error_std * slopes, 0.0)",
            "np.where(selected, 0.0 * slopes, 0.0)",
            "where the loop truly stood is taken for known",
        ),
        (
            "nmt_diagnose/nmt_diagnose/fit/model_alone.py",
            "floor=np.hypot(observations.floor, change)",
            "floor=observations.floor",
            "what the harmonic balance leaves out is taken for an effect",
        ),
        (
            "nmt_blind/nmt_blind/campaign/statistics.py",
            "spread = self.value * (1.0 - self.value) / self.of + z2 / (4.0 * self.of**2)",
            "spread = self.value * (1.0 - self.value) / self.of",
            "no uncertainty where all cases agree",
        ),
        (
            "nmt_blind/nmt_blind/campaign/statistics.py",
            "return float(np.mean((a > b) + 0.5 * (a == b)))",
            "return float(np.mean(a >= b))",
            "ties count as detections",
        ),
        (
            "nmt_blind/nmt_blind/cases/operating.py",
            "stiffness={point: float(omega**2 / shape[point] ** 2) for point in points},",
            "stiffness={point: float(omega**2 * shape[point] ** 2) for point in points},",
            "sizes of injected effects are of another stiffness",
        ),
        (
            "nmt_report/nmt_report/abscissa.py",
            "value * np.hypot(q_std / q, 2.0 * omega_std / omega)",
            "value * np.hypot(q_std / q, omega_std / omega)",
            "too short bars of accelerations",
        ),
        (
            "nmt_report/nmt_report/response_analysis.py",
            "float(np.sqrt(np.mean(error**2))),",
            "float(np.mean(np.abs(error))),",
            "the rms deviation of a held force is a mean",
        ),
        (
            "nmt_report/nmt_report/quantity_format.py",
            "return max(0, min(12, digits - 1 - math.floor(math.log10(std))))",
            "return max(0, min(12, digits - 2 - math.floor(math.log10(std))))",
            "uncertainties of one digit",
        ),
        (
            "nmt_study/nmt_study/signal_noise.py",
            "float(10.0 * np.log10(np.mean(signal**2) / np.mean(noise**2)))",
            "float(20.0 * np.log10(np.mean(signal**2) / np.mean(noise**2)))",
            "signal-to-noise ratios of twice as many dB",
        ),
        (
            "nmt_study/nmt_study/levels.py",
            "np.ptp(np.array(values), axis=0) / np.mean(values, axis=0)",
            "np.std(np.array(values), axis=0) / np.mean(values, axis=0)",
            "the largest difference is a standard deviation",
        ),
        (
            "nmt_bench/nmt_bench/page/guard.py",
            "if _equal(key, self.steer_key) and self._unused:",
            "if _equal(key, self.steer_key):",
            "a key to steer works for everybody who sees it later",
        ),
        (
            "nmt_bench/nmt_bench/commands/stop_command.py",
            "found and all(_at_rest(answer)",
            "found and any(_at_rest(answer)",
            "'stopped' although a bench still moves",
        ),
        (
            "nmt/nmt/results.py",
            "for point in self.good_points])",
            "for point in self.points])",
            "levels without a lock among the values",
        ),
        (
            "nmt/nmt/results.py",
            "spread[number, rows, own] = table.frf_std",
            "spread[number, rows, own] = table.frf_std**2",
            "variances for standard deviations",
        ),
        (
            "nmt_msgs/msg/Level.msg",
            "uint8 CONTROL_RESPONSE=2 ",
            "uint8 CONTROL_RESPONSE=3 ",
            "a level in metres is read as one in newtons",
        ),
        (
            "nmt_msgs/msg/DriveStop.msg",
            "uint8 OUTPUT_HELD=4 ",
            "uint8 OUTPUT_HELD=5 ",
            "'held at zero' and 'released' are the same word",
        ),
    ]
]


def mutated_file(root: Path, mutation: Mutation) -> Path:
    """The file of a mutation in a clone."""
    return next(path for source in ("ros2_ws/src", "campaigns") if (path := root / source / mutation.file).is_file())


def copy_sources() -> None:
    """The sources and tests as they are now, and links to what is built from them."""
    shutil.rmtree(COPY, ignore_errors=True)
    unwanted = shutil.ignore_patterns("__pycache__", "build", "install", "log", ".*_cache", "out")
    for name in ("ros2_ws", "campaigns", "tests", "requirements", "docs", "examples"):
        shutil.copytree(ROOT / name, COPY / name, ignore=unwanted, symlinks=True)
    for path in (*ROOT.glob("*.toml"), *ROOT.glob("*.md"), *ROOT.glob("*.yml"), ROOT / "nmt", ROOT / ".importlinter"):
        shutil.copy2(path, COPY / path.name)
    for name in (".venv", "ros2_ws/build", "ros2_ws/install", ".nmt/installed.txt"):
        (COPY / name).parent.mkdir(parents=True, exist_ok=True)
        (COPY / name).symlink_to(ROOT / name)


def first_failure(arguments: list[str], workers: int) -> str:
    """Name of the first test that fails in the copy; empty if none does."""
    sources = [str(path) for source in ("ros2_ws/src", "campaigns") for path in sorted((COPY / source).iterdir())]
    environment = {
        **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
        "PYTHONPATH": os.pathsep.join([*sources, os.environ.get("PYTHONPATH", "")]),
        "NUMBA_CACHE_DIR": str(COPY.with_name("mutated-kernels")),
        "CI": "1",
    }
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-n", str(workers), "--dist", "worksteal", *arguments]
    try:
        done = subprocess.run(words, cwd=COPY, env=environment, capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return f"no end within {LONGEST:.0f} s"
    if done.returncode in (0, 5):
        return ""
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.M)
    return found[1] if found else (done.stdout + done.stderr)[-300:]


def key_of(mutation: Mutation) -> str:
    """Digest of the mutated file and of the package's own tests."""
    digest = hashlib.sha256(f"{mutation}".encode() + mutated_file(ROOT, mutation).read_bytes())
    for folder in folders_of(mutation.package):
        for path in sorted((ROOT / folder).rglob("*.py")) or [ROOT / folder]:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def folders_of(package: str) -> list[str]:
    """The tests of a package."""
    return FOLDERS.get(package, [f"tests/{package.removeprefix('nmt_')}"])


def stages(mutation: Mutation) -> list[list[str]]:
    """Arguments of one run of pytest after the other: from the nearest tests to all that are left."""
    folders = folders_of(mutation.package)
    module = mutation.file.partition("/")[2].removesuffix(".py").replace("/", ".")
    stem = module.rpartition(".")[2]
    test_files = [path for folder in folders for path in (ROOT / folder).rglob("test_*.py")]
    importing = [path for path in test_files if module in path.read_text(encoding="utf-8")]
    importing.sort(key=lambda path: (stem not in path.name, path.stat().st_size))
    nearest = [str(path.relative_to(ROOT)) for path in importing]
    rest = [f"--ignore={path}" for path in nearest]
    return [*([nearest] if nearest else []), [*folders, *rest], [f"--ignore={path}" for path in (*folders, *nearest)]]


def main() -> int:
    """Apply them; 1 if fewer than 95 % are caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--of", default="", help="only of this package")
    parser.add_argument("--near", action="store_true", help="only the tests of the package")
    parser.add_argument("--again", action="store_true", help="also what is known")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    kept = json.loads(KEPT.read_text()) if KEPT.is_file() else {}
    chosen = [each for each in MUTATIONS if arguments.of in ("", each.package)]
    caught = 0
    copy_sources()
    for number, mutation in enumerate(chosen, start=1):
        key, begun = key_of(mutation), time.monotonic()
        if arguments.again or not kept.get(key):
            path = mutated_file(COPY, mutation)
            text, times = path.read_text(encoding="utf-8"), path.stat()
            if text.count(mutation.old) != 1:
                sys.exit(f"{mutation.file} holds '{mutation.old}' {text.count(mutation.old)} times, not once.")
            path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
            try:
                found = (
                    first_failure(words, arguments.workers)
                    for words in stages(mutation)[: -1 if arguments.near else None]
                )
                kept[key] = next(filter(None, found), "")
            finally:
                path.write_text(text, encoding="utf-8")
                os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # what was compiled of it is good again
            KEPT.write_text(json.dumps(kept, indent=1))
        caught += bool(kept[key])
        said = f"caught by {kept[key]}" if kept[key] else "MISSED"
        seconds = time.monotonic() - begun
        print(f"{number:2d}/{len(chosen)} {seconds:4.0f} s {mutation.file}: {mutation.breaks}: {said}", flush=True)
    print(f"{caught} of {len(chosen)} caught")
    return 0 if caught >= 0.95 * len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
