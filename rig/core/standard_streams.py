"""Standard streams that are missing, or whose readers go away.

A reader may go before a run does (`| head`, a `tee` that dies, a window that is closed), and a program may be begun
without streams (`>&-`, some schedulers). None of this may cost an experiment, its rows or its exit status.
"""

from __future__ import annotations

import contextlib
import os
import sys

TYPE_CHECKING = False  # import-light, for `peltier off`
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, TextIO

STANDARD = 3  # the descriptors 0, 1 and 2


def open_standard_streams() -> None:
    """Open closed standard streams on nothing. Call it before any file is opened: it would take their place."""
    try:
        while (descriptor := os.open(os.devnull, os.O_RDWR)) < STANDARD:
            pass
        os.close(descriptor)
    except OSError:  # no such device here: nothing that could be done
        return
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, "w", encoding="utf-8", closefd=False))


def outlive_readers() -> None:
    """Send lines whose reader has gone to stderr, and from there nowhere, from now on; nothing is raised."""
    sys.stdout = _Lasting(sys.stdout, 2)
    sys.stderr = _Lasting(sys.stderr, None)


class _Lasting:
    """A stream that goes on as the descriptor `instead` (None: nowhere) once it cannot be written any more."""

    def __init__(self, stream: TextIO, instead: int | None) -> None:
        self._stream, self._instead = stream, instead

    def write(self, text: str) -> int:
        self._lasting(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        self._lasting(self._stream.flush)

    def _lasting(self, act: Callable[[], Any]) -> None:
        for elsewhere in (self._instead, None):
            try:
                act()
                return
            except (OSError, ValueError):
                with contextlib.suppress(OSError, ValueError):
                    _replace(self._stream.fileno(), elsewhere)
        with contextlib.suppress(OSError, ValueError):
            act()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _replace(descriptor: int, by: int | None) -> None:
    """Let a descriptor write where another does; None: nowhere."""
    if by is not None:
        os.dup2(by, descriptor)
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)
