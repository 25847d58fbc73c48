"""Compiled functions whose cache is keyed by the formulas that they are made of.

numba asks of a cached function only whether its own file has changed. A function carries what it calls inside itself,
so a formula that changed in another file would go on being computed as it was: a new local element, for example, would
be integrated as one without force. Here the folder of the cache is named by the content of the function's file and of
every module of the bench that this file imports, directly or through others, so that another formula is another folder
for whoever runs it.

Of several processes that need a function one compiles it and the others wait, then read it from the cache.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.compiler_lock import global_compiler_lock

from nmt_core.processes.work_progress import tell

_held: set[Path] = set()
"""Locks that this process holds; whoever changes it holds numba's own lock."""
_IMPORT = re.compile(r"^(?:from (nmt[\w.]*) import (\([^)]*\)|[^\n]*)|import (nmt[\w.]*))", re.M)


def njit(*function: Any, **options: Any) -> Any:
    """``numba.njit``, whose ``cache=True`` is keyed by the formulas; without a folder to write to nothing is cached."""
    if not options.pop("cache", False):
        return numba.njit(*function, **options)

    def compiled(python_function: Any) -> Any:
        code = python_function.__code__
        # numba names the cache by the path, too: a package that is reached through a link has no other.
        python_function.__code__ = code.replace(co_filename=os.path.realpath(code.co_filename))
        folder = cache_folder(python_function)
        if folder is None:
            return numba.njit(**options)(python_function)
        given = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder)  # read once, as the function is decorated
        try:
            dispatcher = numba.njit(cache=True, **options)(python_function)
        finally:
            numba.config.CACHE_DIR = given
        _compile_in_one_process(dispatcher, folder / f"{code.co_name}-{code.co_firstlineno}.lock")
        return dispatcher

    return compiled(*function) if function else compiled


def loop_step(function: Any) -> Any:
    """``njit`` for a step of a compiled loop, which is copied into it and must allocate nothing.

    The arrays of its named tuples then need no count of references, which would cost more than the arithmetic. The loop
    around it, which allocates, takes arrays out of tuples before it begins.
    """
    return njit(function, cache=True, forceinline=True, _nrt=False)


def _compile_in_one_process(dispatcher: Any, lock: Path) -> None:
    """Have a function compiled by whoever holds its lock; the lock of a process that dies is free.

    Args:
        dispatcher: the compiled function with its cache.
        lock: file that the processes share.
    """
    compile_here, load = dispatcher.compile, dispatcher._cache.load_overload

    def compile_once(signature: Any) -> Any:
        # numba's own lock comes first: its holder may need this function while another thread waits for the file.
        with global_compiler_lock, _alone(lock):
            return compile_here(signature)

    def load_or_tell(signature: Any, target: Any) -> Any:
        found = load(signature, target)
        if found is None:
            tell("compiling a numerical kernel (once)")
        return found

    dispatcher.compile = compile_once
    dispatcher._cache.load_overload = load_or_tell


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold the lock of a file, once in a process; without one where the file system has none."""
    if path in _held:  # the function calls itself, or another that does, with arguments of other types
        yield
        return
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError:
        yield
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            tell("waiting for a numerical kernel that another program compiles")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        except OSError:
            pass
        _held.add(path)
        yield
    finally:
        _held.discard(path)
        os.close(descriptor)


def cache_folder(python_function: Any) -> Path | None:
    """Where the compiled code of a function is kept: ``NUMBA_CACHE_DIR``, beside its module, or the user's cache.

    Args:
        python_function: of a module that has been imported as far as this function.

    Returns:
        A folder that exists; None if none can be written to.
    """
    module = python_function.__globals__["__name__"]
    file = Path(python_function.__code__.co_filename)
    name = f"kernels-{file.stem}-{formulas_digest(module)[:16]}"
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nmt"
    bases = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else [file.parent / "__pycache__", user]
    for folder in (base / name for base in bases):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


@cache
def formulas_digest(module: str) -> str:
    """SHA-256 of the sources of :func:`formula_modules`."""
    total = hashlib.sha256()
    for name in formula_modules(module):
        total.update(name.encode() + b"\0" + hashlib.sha256(_source(name)[0]).digest())
    return total.hexdigest()


def formula_modules(module: str) -> list[str]:
    """Names of a module and of those of the bench that it imports, directly or through others.

    Imports count that stand at the left margin, which have run when the module's functions are decorated.
    """
    found = [module]
    for name in found:
        found += [other for other in _source(name)[1] if other not in found]
    return found


@cache
def _source(module: str) -> tuple[bytes, tuple[str, ...]]:
    """Source of a module, and the modules of the bench that it imports; nothing for one that has no file."""
    try:
        content = Path(sys.modules[module].__file__ or "").read_bytes()
    except (KeyError, AttributeError, TypeError, OSError):
        return b"", ()
    imported = []
    for parent, names, alone in _IMPORT.findall(content.decode(errors="replace")):
        own = parent or alone
        imported += [own, *(f"{own}.{name}" for name in re.findall(r"\w+", names))]
    return content, tuple(name for name in dict.fromkeys(imported) if name in sys.modules)
