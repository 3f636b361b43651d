"""A start's question that is asked once more where its answer was lost, hurt, or came too late.

Only for what may be asked twice and proves its answer: who an instrument is, and settings that are read back. A line
that hiccups once (an adapter that hands over half an answer, the rest 0.4 s later) does not end a start.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from rig.core.errors import Corrupt, OutOfStep, TimedOut

P = ParamSpec("P")
T = TypeVar("T")


def asked_again(question: Callable[P, T]) -> Callable[P, T]:
    """The same method, done a second time after TimedOut, Corrupt or OutOfStep."""

    @wraps(question)
    def asked(*args: P.args, **more: P.kwargs) -> T:
        try:
            return question(*args, **more)
        except (TimedOut, Corrupt, OutOfStep):
            return question(*args, **more)

    return asked
