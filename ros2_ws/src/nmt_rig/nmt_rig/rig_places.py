"""Where rig files are: given by path, or by name in the folders of a variable and among the shipped rigs."""

from __future__ import annotations

import os
import re
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.text.proposal import did_you_mean

# Environment variable with folders, separated as in PATH, that are searched for rigs by name first.
RIG_PATH_VARIABLE = "NMT_RIG_PATH"


def _rig_folders() -> list[Path]:
    folders = [Path(part) for part in os.environ.get(RIG_PATH_VARIABLE, "").split(os.pathsep) if part]
    folders.append(Path(__file__).parent / "rigs")
    return folders


def rig_names() -> list[str]:
    """Names of the rigs that can be loaded without a path.

    Examples:
        >>> rig_names()[:5]
        ['beam', 'beam_two_shakers', 'belt', 'clamped_beam', 'frame']
        >>> all(find_rig(name).is_file() for name in rig_names())
        True
    """
    return sorted({path.stem for folder in _rig_folders() for path in folder.glob("*.yaml")})


def find_rig(path_or_name: str | Path) -> Path:
    """File of a rig given by path, or by name: NMT_RIG_PATH first, then the shipped rigs.

    Raises:
        BenchError: no such rig exists.

    Examples:
        >>> find_rig("beam").name
        'beam.yaml'
        >>> find_rig("out/demo/rig.yaml").name
        'rig.yaml'
    """
    path = Path(path_or_name)
    if os.path.isfile(path):  # unlike Path.is_file it does not raise for a name that is too long
        return path
    if re.fullmatch(r"[A-Za-z0-9_-]+", str(path_or_name)):
        for folder in _rig_folders():
            candidate = folder / f"{path_or_name}.yaml"
            if os.path.isfile(candidate):
                return candidate
    known, name = rig_names(), str(path_or_name)[:200]
    raise BenchError(
        f"there is no rig {name}; give the path of a rig file or one of: {', '.join(known) or 'none'}"
        f"{did_you_mean(name, known)}."
    )
