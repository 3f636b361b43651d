"""A call that has to compile loops says so. They are kept on disk, so that the next process finds them ready."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from rig.core.python_words import in_python

P = ParamSpec("P")
T = TypeVar("T")


def says_when_it_compiles(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator: at most one line on stderr a call, and only where a loop is compiled in it; Faults speak Python."""

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> T:
        with in_python(), said_when_compiling(f"rig.{function.__name__}"):
            return function(*args, **kwargs)

    return called


@contextmanager
def said_when_compiling(what: str) -> Iterator[None]:
    """The same, of whatever happens in a context."""
    from numba.core import event

    class Once(event.Listener):
        said = False

        def on_start(self, event: Any) -> None:
            if not self.said:
                self.said = True
                text = f"compiling loops, once (up to a minute; `{ahead()}` does it ahead)"
                print(f"{what}: {text}", file=sys.stderr, flush=True)

        def on_end(self, event: Any) -> None:
            """Nothing: how long it took is seen."""

    with event.install_listener("numba:compile", Once()):
        yield


def ahead() -> str:
    """The command that compiles into where this process looks: the launcher and a service have a folder for it, and
    tell it in NUMBA_CACHE_DIR; without one it is beside the sources."""
    return "peltier precompile" if "NUMBA_CACHE_DIR" in os.environ else "python -m rig precompile"
