"""The demo's ten levels on a converter with the specimen behind its ports, compared with the simulated demo.

./nmt shell <<< "python tests/node/converter_demo.py portaudio"
./nmt shell <<< "python tests/node/converter_demo.py nidaqmx"
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from node.converter_bench import KINDS, Difference, converter_bench, differences, simulated

MOST_FREQUENCY, MOST_DAMPING = 1e-4, 5e-3


def compare(kind: str, folder: Path, *words: str) -> tuple[list[Difference], str]:
    """The test on the converter and simulated, and what the command said of the former.

    Args:
        kind: of the converter.
        folder: for the results, in ``run`` and ``simulated``.
        words: options of both tests.
    """
    simulated(kind, folder, "run", "--no-report", *words, "--out", str(folder / "simulated"))
    with converter_bench(kind, folder) as bench:
        bench.check()
        said = bench.command("run", "--quiet", "--force", *words, "--out", str(folder / "run"))
    return differences(folder / "run", folder / "simulated"), said


def main() -> int:
    """Print the table; 0 where all levels agree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--levels", default="0.05:1.5:10")
    parser.add_argument("--periods", default="200")
    parser.add_argument("--keep", type=Path, help="folder for the results (default: thrown away)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        found, said = compare(given.kind, folder, "--levels", given.levels, "--periods", given.periods)
    print("\n".join(line for line in said.splitlines() if line.startswith(("Converter", "Real time", "Recorded"))))
    print(f"{'level':>8} {'ω̃/2π, Hz':>12} {'simulated':>12} {'Δ, %':>9} {'δ̃, %':>10} {'simulated':>10} {'Δ, %':>8}")
    for each in found:
        print(
            f"{each.level:8.4f} {each.frequency_hz[0]:12.6f} {each.frequency_hz[1]:12.6f} "
            f"{100 * each.frequency_difference:9.5f} {100 * each.damping[0]:10.6f} {100 * each.damping[1]:10.6f} "
            f"{100 * each.damping_difference:8.4f}"
        )
    frequency = max(abs(each.frequency_difference) for each in found)
    damping = max(abs(each.damping_difference) for each in found)
    print(f"{len(found)} levels; largest differences {100 * frequency:.5f} % and {100 * damping:.4f} %")
    return 0 if frequency <= MOST_FREQUENCY and damping <= MOST_DAMPING else 1


if __name__ == "__main__":
    sys.exit(main())
