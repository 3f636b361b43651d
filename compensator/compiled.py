"""The decorators of our compiled loops, and the cache that keeps their machine code on disk.

    @njit                                  # as numba's; also @njit(error_model="numpy", ...)
    @cfunc("float64(float64)")             # as numba's: machine code at an address

One loop, compiled for one list of argument types, is one file. Its name contains a digest of everything that the
machine code is made of: the function, whatever it calls and every constant that it reads, in whichever file these
stand, the compiler's options and version, and the processor. So loops of other sources never come out of a cache, of
whoever's folder; nothing has to be deleted after an update; and processes that compile the same loop at once write the
same file. A file begins with a digest of the rest, and one that is damaged is compiled again.

(numba's own cache looks only at the file of the loop itself, not at what it calls, raises where a file is damaged or no
folder can be written, and mixes up the files of two processes that compile one function for other types.)

Loops are kept in NUMBA_CACHE_DIR where that is set; else beside the sources, in `__pycache__`, and where that cannot be
written in the user's cache folder. Where nothing can be written they are compiled in memory, and a line says so.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import pickle
import secrets
import sys
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, get_type_hints, overload

import llvmlite  # type: ignore[import-untyped]
import numba
import numpy as np
from numba.core.ccallback import CFunc
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.misc.appdirs import AppDirs

from compensator import listeners

config: Any = numba.config
F = TypeVar("F", bound=Callable[..., Any])

VERSIONS = (sys.version, numba.__version__, llvmlite.__version__, np.__version__)
OF_A_VERSION = frozenset(("numba", "llvmlite", "numpy", *sys.stdlib_module_names))  # their code: `VERSIONS` have it
OPTIONS = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE")  # of numba.config
COMPILED: Any = Dispatcher | CFunc | _Intrinsic
CHECK = 32  # bytes of digest at the beginning of a file
FEW = 5  # loops compiled in a process, seconds: not worth a line
_made: dict[int, tuple[Any, bytes, list[Any]]] = {}  # of a function or class: itself, digest, what it refers to


@overload
def njit(function: F) -> F: ...
@overload
def njit(**options: Any) -> Callable[[F], F]: ...
def njit(function: Any = None, **options: Any) -> Any:
    """Compile a function as `numba.njit` does, and keep the machine code on disk."""
    if function is None:
        return lambda function: njit(function, **options)
    loop: Any = numba.njit(**options)(function)
    loop._cache = _Cache(loop)
    return loop


def cfunc(signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as `numba.cfunc` does, and keep the machine code on disk."""

    def compiled(function: Callable[..., Any]) -> Any:
        types = normalize_signature(signature)  # type: ignore[no-untyped-call]
        callback: Any = CFunc(function, types, locals={}, options=options)
        callback._cache = _Cache(function, options)
        callback.compile()
        return callback

    return compiled


def folders() -> list[Path]:
    """Return where compiled loops are looked for, in order; a new one is kept in the first that can be written."""
    if config.CACHE_DIR:
        return [Path(os.path.expanduser(config.CACHE_DIR)).absolute()]
    of_user = Path(AppDirs("peltier-rig", appauthor=False).user_cache_dir)  # type: ignore[no-untyped-call]
    beside = Path(importlib.util.cache_from_source(__file__)).parent
    return [beside, *([of_user] if of_user.is_absolute() else [])]  # without a home the name begins with "~"


def _report(line: str) -> None:
    for listener in listeners[-1:]:
        listener(line)


class _Cache:
    """Cache of one loop's machine code on disk, in the place of numba's."""

    told = False  # that it compiles, and that nothing can be kept: once a process each
    told_unkept = False
    count = 0  # of the loops that are compiled

    def __init__(self, loop: Any, options: Any = None) -> None:
        self._loop, self._options = loop, options

    @property
    def cache_path(self) -> str:
        """Return the folder where a new loop is kept, for `numba`'s statistics."""
        return str(folders()[0])

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what was compiled for a signature before, None if there is nothing that can be used."""
        context.refresh()
        name = self._name(signature, context.codegen())
        for folder in folders():
            try:
                content = (folder / name).read_bytes()
                if hashlib.sha256(content[CHECK:]).digest() == content[:CHECK]:
                    return CompileResult._rebuild(context, *pickle.loads(content[CHECK:]))  # type: ignore[no-untyped-call]
            except Exception:  # whatever is wrong with a file, compiling makes it anew
                continue
        _Cache.count += 1
        if _Cache.count > FEW and not _Cache.told:
            _Cache.told = True
            _report("compiling numerical code at its first use (`peltier precompile` does it beforehand)")
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep what has been compiled, unless it holds for this process only."""
        if result.library.has_dynamic_globals or not all(each.can_cache for each in result.lifted):
            return
        content: bytes = dumps(result._reduce())  # type: ignore[no-untyped-call]
        name = self._name(signature, result.library.codegen)
        problems = []
        for folder in folders():
            try:
                _write(folder / name, hashlib.sha256(content).digest() + content)
                return
            except OSError as error:
                problems.append(f"{folder}: {error.strerror or error}")
        if not _Cache.told_unkept:
            _Cache.told_unkept = True
            text = f"compiled loops cannot be kept ({'; '.join(problems)})"
            _report(f"{text}: set NUMBA_CACHE_DIR to a folder that can be written")

    def flush(self) -> None:
        """Do nothing: a file that is there is right."""

    def _name(self, signature: Any, codegen: Any) -> str:
        """Return the name of the file: equal if everything that the machine code is made of is equal."""
        function = getattr(self._loop, "py_func", self._loop)
        arguments = [getattr(signature, "return_type", None), *getattr(signature, "args", signature)]
        options = _value(self._options, (), []), [getattr(config, name, None) for name in OPTIONS]
        key = hashlib.sha256(repr((VERSIONS, codegen.magic_tuple(), [str(a) for a in arguments], options)).encode())
        for digest in sorted(_reachable([self._loop, *chain(*map(_classes, arguments))])):
            key.update(digest)
        return f"{function.__module__}.{function.__qualname__}"[-100:].replace("<", "").replace(">", "") + (
            f"-{key.hexdigest()[:32]}.nbc"
        )


def _write(path: Path, content: bytes) -> None:
    """Write a file that others see whole or not at all. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f"{secrets.token_hex(8)}.tmp")
    try:
        new.write_bytes(content)
        os.replace(new, path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def _classes(kind: Any) -> Iterator[Any]:
    """Yield the named tuples among the types of an argument: numba's name of one does not contain its fields."""
    if hasattr(kind, "instance_class"):
        yield kind.instance_class
    for inside in getattr(kind, "types", ()):
        yield from _classes(inside)


def _reachable(roots: list[Any]) -> set[bytes]:
    """Return the digests of functions and classes, and of all that they refer to, directly or through others."""
    digests, todo, seen = set(), list(roots), set()
    while todo:
        one = todo.pop()
        if id(one) not in seen:
            seen.add(id(one))
            if id(one) not in _made:  # with the object, so that the number stays its own
                referred: list[Any] = []
                _made[id(one)] = (one, hashlib.sha256(repr(_ingredients(one, referred)).encode()).digest(), referred)
            _, digest, others = _made[id(one)]
            digests.add(digest)
            todo += others
    return digests


def _ingredients(one: Any, referred: list[Any]) -> Any:
    """Return a loop, function or class as plain values; what it refers to is added to a list."""
    if isinstance(one, Dispatcher):
        return _value(one.targetoptions, (), referred), _ingredients(one.py_func, referred)
    if isinstance(one, COMPILED):
        return _ingredients(one.__wrapped__, referred)
    if isinstance(one, type):
        if hasattr(one, "_fields"):
            hints = get_type_hints(one)
            fields = [(name, _value(hints.get(name), (), referred)) for name in one._fields]
            return one.__module__, one.__qualname__, fields
        file = getattr(sys.modules.get(one.__module__), "__file__", None)
        return one.__module__, one.__qualname__, file and Path(file).read_bytes()
    closure = [cell.cell_contents for cell in one.__closure__ or ()]
    codes = list(_codes(one.__code__))
    names = list(dict.fromkeys(name for code in codes for name in code.co_names))
    values = [one.__globals__[name] for name in names if name in one.__globals__]
    return (
        (one.__module__, one.__qualname__),
        [(c.co_code, c.co_names, c.co_varnames, c.co_freevars, c.co_flags, _plain(c, one.__doc__)) for c in codes],
        [_value(value, names, referred) for value in (*values, *closure, one.__defaults__, one.__kwdefaults__)],
    )


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a function's code and that of the functions inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _plain(code: CodeType, documentation: str | None) -> list[Any]:
    """Return the constants of a function's code, without its documentation."""
    constants = (c for c in code.co_consts if not isinstance(c, CodeType) and c != documentation)
    return [_value(c, (), []) for c in constants]


def _value(value: Any, names: Any, referred: list[Any]) -> Any:
    """Return a value that a function reads, as plain values. names: the attributes that it may take of a module."""
    module = value.__name__ if isinstance(value, ModuleType) else str(getattr(value, "__module__", ""))
    if module.partition(".")[0] in OF_A_VERSION and hasattr(value, "__name__"):
        return module, value.__name__
    if isinstance(value, ModuleType):
        return module, [_value(getattr(value, name), names, referred) for name in names if hasattr(value, name)]
    if isinstance(value, COMPILED | FunctionType | type):
        referred.append(value)
        return module, getattr(value, "__qualname__", "")
    if hasattr(value, "__wrapped__"):  # functools.cache
        return _value(value.__wrapped__, names, referred)
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, dict):
        return [(repr(key), _value(each, names, referred)) for key, each in value.items()]
    if isinstance(value, tuple | list):
        return [_value(each, names, referred) for each in value]
    if isinstance(value, set | frozenset):  # their order is another in each process
        return sorted(repr(each) for each in value)
    text = repr(value)
    return _value(type(value), names, referred), "" if " at 0x" in text else text  # an address differs in each process
