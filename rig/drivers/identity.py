"""Identity of an instrument, and a start that survives one lost answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import ParamSpec, TypeVar

from rig.core.errors import Corrupt, OutOfStep, TimedOut

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity as the instrument reports it; empty if it reports none."""

    maker: str
    model: str
    serial_number: str
    firmware: str

    def __str__(self) -> str:
        return f"{self.maker} {self.model}, serial number {self.serial_number}, firmware {self.firmware}"

    @classmethod
    def of_idn(cls, answer: str) -> Identity:
        """Return the four fields of an answer to `*IDN?`."""
        return cls(*(part.strip() for part in (answer + ",,,").split(",")[:4]))


def retry_once(question: Callable[P, T]) -> Callable[P, T]:
    """Decorate a method of a driver's start so that it is done a second time after TimedOut, Corrupt or OutOfStep.

    For methods that may be done twice and prove their answers: identity, and settings that are read back. A line that
    hiccups once (an adapter that hands over half an answer, the rest 0.4 s later) does not end a start.
    """

    @wraps(question)
    def asked(*args: P.args, **more: P.kwargs) -> T:
        try:
            return question(*args, **more)
        except (TimedOut, Corrupt, OutOfStep):
            return question(*args, **more)

    return asked
