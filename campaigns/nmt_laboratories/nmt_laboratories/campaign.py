"""Makes cases of the laboratories two (four rigs), three (a free beam), four (robots) for ``./nmt blind laboratory``,
healthy tables of all whose stated uncertainties are off, and cantilevers with soft clamps.

Run in ``./nmt shell``::

    python -m nmt_laboratories.campaign make --laboratory three --seeds 0:32 --out cases --jobs 2
    ./nmt blind laboratory cases --out answers

A case that is there already is not made again. The same seed gives the same case. Every third seed of laboratory two
is healthy (``--seeds 0:600:3``).
"""

from __future__ import annotations

import time
from importlib import import_module
from pathlib import Path

from joblib import Parallel, delayed

from nmt_laboratories.campaign_frame import command_parser, seeds_of

LABORATORIES = {
    "two": "laboratory_two",
    "three": "laboratory_three",
    "four": "laboratory_four",
    "healthy": "healthy_tables",
    "clamps": "soft_clamps",
}


def main() -> None:
    """Make the cases that are not there yet, and say each."""
    parser = command_parser(__doc__)
    parser.add_argument("part", choices=("make",), help="what to do")
    parser.add_argument("--laboratory", choices=[*LABORATORIES], default="two", help="whose cases (default two)")
    parser.add_argument("--seeds", type=seeds_of, required=True, metavar="FIRST:END[:STEP]", help="the end is left out")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets a folder for each case")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default 1)")
    given = parser.parse_args()
    begin = time.monotonic()
    make_case = import_module(f"nmt_laboratories.{LABORATORIES[given.laboratory]}").make_case
    work = (delayed(make_case)(given.out.resolve(), seed) for seed in given.seeds)
    for number, name in enumerate(Parallel(n_jobs=given.jobs, return_as="generator_unordered")(work), 1):
        print(f"{number} of {len(given.seeds)}, {time.monotonic() - begin:.0f} s: {name}", flush=True)


if __name__ == "__main__":
    main()
