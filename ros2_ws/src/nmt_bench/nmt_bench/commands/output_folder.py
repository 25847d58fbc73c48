"""The ``--out`` folder of a command: never overwritten by mistake, never half-written."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import umask

RESULT_NAMES = (
    "bag",
    "modal.csv",
    "modal.json",
    "hysteresis.csv",
    "limit_cycles.csv",
    "report.html",
    "rig.yaml",
    "run.json",
    "output.jsonl",
    "reference.csv",
    "shapes.csv",
    "linear.json",
    "frf.csv",
    "frf.uff",
    "modes.uff",
    "data.uff",
    "data.csv",
    "data.npz",
    "data.h5",
    "data.mat",
    "oscillator.csv",
    "loop.csv",
    "sidecar.yaml",
    "synthesis.csv",
    "study.csv",
    "diagnosis.json",
    "joints.csv",
    "changes.csv",
    "robot.xml",
    "robot.urdf",
    "next_motion.csv",
    "repair.json",
    "check.json",
    "figures",
)
"""Names that commands write; ``--force`` replaces these and touches nothing else in the folder."""


class OutputFolder:
    """Context manager around the results of one command.

    Without ``live`` the command writes to a hidden folder next to ``path``, whose contents are moved in place
    when the block ends well and removed when it does not: what is in ``path`` is always whole. With ``live``
    the command writes in place, for recordings that must survive a killed process; an empty folder is removed
    again. A folder that somebody deletes meanwhile is the sentence that the command ends with.

    Args:
        path: the folder of the results.
        force: replace results that are there already.
        live: write in place.

    Raises:
        BenchError: on entry, if the folder cannot be made, is not a folder, is written by another command, or is not
        empty and ``force`` is not set; on exit, if it is no longer there, or another command has filled it.
    """

    def __init__(self, path: Path | str, force: bool = False, live: bool = False) -> None:
        self.path = Path(path)
        self._force = force
        self._live = live
        self._work = self.path
        self._made = False
        self._lock: int | None = None

    def __enter__(self) -> Path:
        check_output(self.path, self._force)
        try:
            if self._live:
                self._made = not self.path.exists()
                self.path.mkdir(parents=True, exist_ok=True)
                self._lock = _locked(self.path)
                if self._lock is None:
                    raise _taken(self.path)
                if not self._force and any(self.path.iterdir()):
                    os.close(self._lock)
                    raise _not_empty(self.path)
                for name in RESULT_NAMES:
                    _remove(self.path / name)
            else:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._work = Path(tempfile.mkdtemp(prefix=f".{self.path.name}.part-", dir=self.path.parent))
                self._work.chmod(0o777 & ~umask())
        except OSError as error:
            raise BenchError(
                f"The results folder {self.path} cannot be written ({_reason(error)}); choose another with --out."
            ) from error
        return self._work

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._lock is not None:
            os.close(self._lock)
        if not self._work.is_dir() and (kind is None or issubclass(kind, Exception)):
            raise BenchError(
                f"The results folder {self._work} was deleted while the command wrote to it, so its results are lost; "
                "run the command again."
            ) from error
        if self._live:
            if kind is not None and self._made and self.path.is_dir() and not any(self.path.iterdir()):
                self.path.rmdir()
            return
        try:
            if kind is None:
                self._commit()
        finally:
            shutil.rmtree(self._work, ignore_errors=True)

    def _commit(self) -> None:
        if not self.path.exists():
            self._work.rename(self.path)
            return
        check_output(self.path, self._force)  # another command may have been here meanwhile
        for item in sorted(self._work.iterdir()):
            target = self.path / item.name
            if item.is_dir() or target.is_dir():
                _remove(target)
            os.replace(item, target)


def check_output(path: Path, force: bool, replace: str = "force") -> None:
    """Refuse an output folder that would be overwritten.

    Args:
        path: the folder.
        force: earlier results may be replaced.
        replace: name of the option that says so.

    Raises:
        BenchError: ``path`` is a file, a folder that another command is writing to, or one that is not empty while
            ``force`` is not set.
    """
    try:
        path.exists()
    except (OSError, ValueError) as error:
        why = _reason(error) if isinstance(error, OSError) else str(error)
        raise BenchError(f"The results folder {path} cannot be used ({why}); choose another with --out.") from error
    if path.exists() and not path.is_dir():
        raise BenchError(f"The results folder {path} is a file; choose another with --out.")
    if path.is_dir() and any(path.iterdir()):
        lock = _locked(path)
        if lock is None:
            raise _taken(path)
        os.close(lock)
    if path.is_dir() and not force and any(path.iterdir()):
        raise _not_empty(path, replace)


def free_folder(path: Path) -> Path:
    """``path`` if it is free, else the first of ``path-2``, ``path-3`` … that is."""
    candidate, number = path, 1
    while candidate.exists() and (not candidate.is_dir() or any(candidate.iterdir())):
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


def _locked(folder: Path) -> int | None:
    """Descriptor that holds a folder for one command, as the system frees it with the process; None if it is taken."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    except OSError:
        pass  # a file system without locks
    return handle


def _not_empty(folder: Path, replace: str = "force") -> BenchError:
    return BenchError(
        f"The results folder {folder} is not empty; choose another with --out, or add --{replace} to replace its "
        "results."
    )


def _taken(folder: Path) -> BenchError:
    name = ""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        name = f" (run {json.loads((folder / 'run.json').read_text(encoding='utf-8'))['run_id']})"
    return BenchError(
        f"Another command is writing to the results folder {folder}{name}; wait for its end, or choose another with "
        "--out."
    )


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
