"""What the set-up prepares for the processes of a bench."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from nmt_bench.warm_up import SOURCES, write_byte_code


def test_byte_code_is_there_and_taken_where_python_writes_none(tmp_path: Path) -> None:
    package = tmp_path / "src" / "nmt_some" / "nmt_some"
    (package / "deep").mkdir(parents=True)
    for path in (package / "__init__.py", package / "deep" / "__init__.py", package / "deep" / "module.py"):
        path.write_text("VALUE = 1\n")
    (tmp_path / "src" / "nmt_some" / "setup.py").write_text("raise SystemExit\n")
    (package / "broken.py").write_text("def\n")
    write_byte_code(tmp_path / "src")
    assert len(list((tmp_path / "src").rglob("*.pyc"))) == 3
    code = "import sys; import nmt_some.deep.module as m; print(sys.dont_write_bytecode, m.__spec__.cached, m.VALUE)"
    environment = {**os.environ, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1"}
    seen = subprocess.run(
        [sys.executable, "-v", "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    cached = package / "deep" / "__pycache__" / f"module.{sys.implementation.cache_tag}.pyc"
    assert seen.stdout.split() == ["True", str(cached), "1"]
    assert f"code object from '{cached}'" in seen.stderr or f"matches {package / 'deep' / 'module.py'}" in seen.stderr


def test_the_sources_are_those_of_all_packages() -> None:
    assert (SOURCES / "nmt_plant" / "nmt_plant" / "plant_node.py").is_file()
