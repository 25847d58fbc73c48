"""``python -m nmt_bench``: the command line without the installed script."""

from __future__ import annotations

import sys

from nmt_bench.cli import main

if __name__ == "__main__":
    sys.exit(main())
