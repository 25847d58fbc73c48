"""Compiled functions whose cache is keyed by the formulas that they are made of.

numba asks of a cached function only whether its own file has changed. A function carries what it calls inside itself,
so a formula that changed in another file would go on being computed as it was: a new local element, for example, would
be integrated as one without force. And a file that changed in a comment, or was checked out anew, would be compiled
again. Here the name of the cached file has a digest of the function's own instructions and constants, and of all that
it names: functions that it calls, classes, values. Another formula is another file for whoever runs it, and nothing
else is.

Of several processes that need a function one compiles it and the others wait, then read it from the cache.
"""

from __future__ import annotations

import contextlib
import enum
import fcntl
import hashlib
import os
import sys
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from pickle import UnpicklingError
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from nmt_core.processes.work_progress import tell

_KEPT = 4
"""Versions of a function of which the compiled code is kept: those of the branches that a developer changes between."""
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis), np.generic, np.dtype)
_LIBRARIES = {*sys.stdlib_module_names, "numba", "numpy", "scipy"}
_digests: dict[Any, str] = {}
"""Of compiled functions whose digest was asked for."""
if "NUMBA_OPT" not in os.environ:
    # A third of the time of compilation less than with numba's 3, and loops that run as fast.
    numba.config.OPT = type(numba.config.OPT)(2)
_held: set[Path] = set()
"""Locks that this process holds; whoever changes it holds numba's own lock."""


def njit(*function: Any, **options: Any) -> Any:
    """``numba.njit``, whose ``cache=True`` is keyed by the formulas; without a folder to write to nothing is cached.

    A constant that is handed over makes no version of the function of its own: numba would compile one for each -1,
    True and False next to that for any number.
    """
    cached = options.pop("cache", False)

    def compiled(python_function: Any) -> Any:
        dispatcher = numba.njit(**options)(python_function)
        compile_here = dispatcher.compile
        dispatcher.compile = lambda signature: compile_here(_without_constants(signature))
        folder = cache_folder(python_function) if cached else None
        if folder is not None:
            dispatcher._cache = _KeyedCache(dispatcher, folder)
            _compile_in_one_process(dispatcher)
        return dispatcher

    return compiled(*function) if function else compiled


def _without_constants(signature: Any) -> Any:
    """Types of a call without the values of those that are constant; a signature that is written out stays."""
    return tuple(map(numba.types.unliteral, signature)) if isinstance(signature, tuple) else signature


def loop_step(function: Any) -> Any:
    """``njit`` for a step of a compiled loop, which is copied into it and must allocate nothing.

    The arrays of its named tuples then need no count of references, which would cost more than the arithmetic. The loop
    around it, which allocates, takes arrays out of tuples before it begins.
    """
    return njit(function, cache=True, forceinline=True, _nrt=False)


class _KeyedCache(FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, whose files are named by the digest of its formulas.

    The digest is made as the first signature is asked for: what the function calls may stand after it in its module.

    Args:
        dispatcher: the compiled function.
        folder: where the files are.
    """

    def __init__(self, dispatcher: Any, folder: Path) -> None:
        self._dispatcher, self._py_func = dispatcher, dispatcher.py_func
        self._name = repr(self._py_func)
        self._impl = _Results(self._py_func, folder)
        self._cache_path = str(folder)
        self.enable()

    @cached_property
    def file_name(self) -> str:
        """Name of the cached files without their ends."""
        return f"{self._impl.function_name}-{_digest_of_compiled(self._dispatcher)[:16]}"

    @cached_property
    def lock(self) -> Path:
        """File that the processes share which need the function."""
        return Path(self._cache_path) / f"{self.file_name}.lock"

    @cached_property
    def _cache_file(self) -> IndexDataCacheFile:
        return _Index(self._cache_path, self.file_name, self.file_name)

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        """With the fields of named tuples that are handed over: to numba they are their types."""
        return (*super()._index_key(signature, codegen), _fields(signature))

    def save_overload(self, signature: Any, data: Any) -> None:
        """Save the code of a signature; versions of the function beyond the last four are deleted."""
        super().save_overload(signature, data)
        folder, name = Path(self._cache_path), self._impl.function_name
        with contextlib.suppress(OSError):
            indices = sorted(folder.glob(f"{name}-{'[0-9a-f]' * 16}.nbi"), key=lambda path: -path.stat().st_mtime)
            for old in indices[_KEPT:]:
                for path in folder.glob(f"{old.stem}.*"):
                    path.unlink(missing_ok=True)


class _Index(IndexDataCacheFile):  # type: ignore[misc]
    """numba's index of the cached signatures; one that cannot be read is made anew.

    It holds the classes of named tuples that were handed over, which may have got another name since.
    """

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except (AttributeError, ImportError, EOFError, ValueError, UnpicklingError):
            return {}


class _Results(CompileResultCacheImpl):  # type: ignore[misc]
    """How numba writes and reads compiled code; it asks no source file how old it is."""

    def __init__(self, python_function: Any, folder: Path) -> None:
        self._py_file = python_function.__code__.co_filename
        self._lineno = python_function.__code__.co_firstlineno
        self._locator, self._folder = self, folder
        file, name = Path(self._py_file).stem, python_function.__qualname__.replace("<", "").replace(">", "")
        self.function_name = f"{file}.{name}"

    def ensure_cache_path(self) -> None:
        """Make the folder, which may have been deleted since."""
        self._folder.mkdir(parents=True, exist_ok=True)


def _compile_in_one_process(dispatcher: Any) -> None:
    """Have a function compiled by whoever holds its lock; the lock of a process that dies is free.

    Args:
        dispatcher: the compiled function with its cache.
    """
    compile_here, load = dispatcher.compile, dispatcher._cache.load_overload

    def compile_once(signature: Any) -> Any:
        # numba's own lock comes first: its holder may need this function while another thread waits for the file.
        with global_compiler_lock, _alone(dispatcher._cache.lock):
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
    """Where the compiled code of a function is kept: ``NUMBA_CACHE_DIR``, next to its module, or the user's cache.

    Returns:
        A folder that exists; None if none can be written to.
    """
    # A package that is reached through a link has no other folder.
    file = Path(os.path.realpath(python_function.__code__.co_filename))
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nmt"
    bases = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else [file.parent / "__pycache__", user]
    for folder in (base / "kernels" for base in bases):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


def formulas_digest(python_function: Any, options: dict[str, Any] | None = None) -> str:
    """SHA-256 of a function's instructions and constants, and of all that it names, directly or through others.

    Comments, docstrings, annotations, line numbers and what else stands in the files do not count.

    Args:
        python_function: of a module that has been imported to its end.
        options: of the compiler.

    Raises:
        TypeError: the function names a value of which no digest can be made.
    """
    return _Digest().of(python_function, options or {})


def _digest_of_compiled(dispatcher: Any) -> str:
    """Digest of a compiled function and its options, made once in a process; in itself a function has none."""
    if dispatcher not in _digests:
        _digests[dispatcher] = "itself"
        try:
            _digests[dispatcher] = formulas_digest(dispatcher.py_func, dispatcher.targetoptions)
        except BaseException:
            del _digests[dispatcher]
            raise
    return _digests[dispatcher]


class _Digest:
    """Writes what a function is made of, each part once."""

    def __init__(self) -> None:
        self._total = hashlib.sha256()
        self._met: dict[int, Any] = {}

    def of(self, function: Any, options: dict[str, Any]) -> str:
        """Digest of a function and of the compiler's options."""
        self._value(options, str(function))
        self._value(function, str(function))
        return self._total.hexdigest()

    def _write(self, *parts: object) -> None:
        self._total.update("\0".join(map(str, parts)).encode() + b"\1")

    def _first(self, thing: Any) -> bool:
        """Whether a part is met for the first time; else where it was met before."""
        if id(thing) in self._met:
            self._write("as", list(self._met).index(id(thing)))
            return False
        self._met[id(thing)] = thing
        return True

    def _value(self, value: Any, where: str) -> None:
        """A value that a function names; `where` says which, for the error."""
        if isinstance(value, _PLAIN):
            self._write(type(value).__name__, repr(value))
        elif isinstance(value, np.ndarray):
            self._write(value.dtype, value.shape, value.tobytes().hex())
        elif isinstance(value, CodeType):
            self._code(value, where)
        elif isinstance(value, enum.Enum):
            self._write(type(value).__qualname__, value.name)
            self._value(value.value, where)
        elif isinstance(value, (list, tuple)):
            self._write(type(value).__name__, len(value))
            for part in value:
                self._value(part, where)
        elif isinstance(value, (set, frozenset)):
            self._write(type(value).__name__, sorted(map(repr, value)))
        elif isinstance(value, dict):
            self._write("dict", len(value))
            for key, part in value.items():
                self._value(key, where)
                self._value(part, where)
        elif isinstance(value, Dispatcher):
            self._write("compiled", _digest_of_compiled(value))
        elif isinstance(value, MethodType):
            self._value(value.__func__, where)
        elif isinstance(value, numba.types.Type):
            self._write("type", value)
        elif not _of_the_bench(value) and (callable(value) or isinstance(value, ModuleType)):
            self._write(getattr(value, "__module__", ""), getattr(value, "__name__", type(value).__qualname__))
        elif isinstance(value, FunctionType):
            if self._first(value):
                self._function(value)
        elif isinstance(value, (staticmethod, classmethod)):
            self._value(value.__func__, where)
        elif isinstance(value, type):
            if self._first(value):
                self._class(value, where)
        elif isinstance(value, ModuleType):
            self._write(value.__name__)
        else:
            raise TypeError(f"{where}: no digest can be made of {value!r}, which a compiled function names")

    def _function(self, function: FunctionType) -> None:
        self._write("function", function.__qualname__)
        where = f"{function.__module__}.{function.__qualname__}"
        self._value(function.__defaults__, where)
        self._code(function.__code__, where, function.__doc__)
        for cell in function.__closure__ or ():
            with contextlib.suppress(ValueError):  # it is empty as yet
                self._value(cell.cell_contents, where)
        self._names(function.__code__, function.__globals__, where)

    def _code(self, code: CodeType, where: str, docstring: str | None = None) -> None:
        # A function without a docstring has None in its place.
        constants = code.co_consts[1:] if code.co_consts[:1] == (docstring,) else code.co_consts
        self._write(code.co_code.hex(), code.co_names, code.co_freevars, code.co_argcount, code.co_flags)
        self._value(constants, where)

    def _names(self, code: CodeType, known: dict[str, Any], where: str) -> None:
        """What the names of some instructions stand for, also where they follow a module's name."""
        values = [(name, known[name]) for name in code.co_names if name in known]
        modules = [value for _, value in values if isinstance(value, ModuleType) and _of_the_bench(value)]
        values += [(name, vars(module)[name]) for module in modules for name in code.co_names if name in vars(module)]
        for name, value in values:
            self._write(name)
            self._value(value, f"{where}: {name}")
        for part in code.co_consts:
            if isinstance(part, CodeType):
                self._names(part, known, where)

    def _class(self, kind: type, where: str) -> None:
        """A class: its fields and their types, and its plain values."""
        self._write("class", kind.__qualname__, [name.__qualname__ for name in kind.__mro__])
        self._write(sorted((name, str(what)) for name, what in vars(kind).get("__annotations__", {}).items()))
        self._write(getattr(kind, "_fields", ()))
        for name, value in sorted(vars(kind).items()):
            if isinstance(value, (*_PLAIN, FunctionType)) and not name.startswith("__"):
                self._write(name)
                self._value(value, f"{where}: {name}")


def _of_the_bench(value: Any) -> bool:
    """Whether a function, class or module is not of a library: its content counts, of a library's the name."""
    module = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    return str(module or type(value).__module__).partition(".")[0] not in _LIBRARIES


def _fields(kinds: Any) -> tuple[Any, ...]:
    """Names of the fields of all named tuples among some types of numba."""
    found: tuple[Any, ...] = ()
    for kind in kinds:
        if isinstance(kind, numba.types.BaseNamedTuple):
            found += ((kind.instance_class.__qualname__, tuple(kind.fields)),)
        if isinstance(kind, numba.types.BaseTuple):
            found += _fields(kind)
    return found
