"""``python -m nmt_bench``: the command line without the installed script."""

from __future__ import annotations

from nmt_bench.cli import program

if __name__ == "__main__":
    program()
