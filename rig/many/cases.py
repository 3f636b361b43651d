"""Cases on an engine: each comes back once, whatever becomes of the processes that compute it.

A process that dies takes others' cases with it, and nobody can tell whose case it was. So everything that was on its
way is then computed again, one case at a time: a process that dies now has died of its own case, or was killed from
outside, and the case is tried `TRIES` times before it is given up. Nothing else is lost, and nothing else stops.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass
from itertools import islice
from typing import Any

from rig.core.outcome import Stopped
from rig.many.engine import Engine

TRIES = 3  # a case whose process died three times alone is what kills it, and not somebody's `kill`
WAITING = 2  # cases for each worker: one that runs, one that waits, so that no worker is idle while a result travels
LOOK_S = 1.0  # between two looks for a signal, which takes microseconds
LOST = ("KilledWorker", "CommClosedError", "FutureCancelledError")  # what Dask raises for cases whose process died


@dataclass(frozen=True)
class Case:
    """What there is to compute: work(*arguments), in another process; both have to be such that they travel there."""

    number: int
    work: Callable[..., Any]
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Ended:
    """What came out of a case. fault: "" or why there is no value; seconds: that it took where it ran."""

    number: int
    value: Any
    fault: str = ""
    seconds: float = 0.0


def each_ended(cases: Iterable[Case], engine: Engine) -> Iterator[Ended]:
    """Every case once, in the order in which they end; those that are found ended at once, in the order given. Only so
    many are on their way that no worker waits. Raises Faults where the engine is gone for good."""
    left = iter(cases)
    flying: dict[Future[Any], Case] = {}
    while True:
        lost = _submitted(islice(left, max(0, WAITING * engine.workers - len(flying))), engine, flying)
        if not flying and not lost:
            return
        ended = _some(flying) if flying and not lost else set()
        for future in [one for one in flying if one in ended]:  # a set's own order is another one in each process
            case = flying.pop(future)
            found = _result(case, future)
            if found is None:
                lost.append(case)
            else:
                yield found
        if lost:
            for future, case in flying.items():
                found = _result(case, future) if future.done() else None
                if found is None:
                    lost.append(case)
                else:
                    yield found
            flying.clear()
            engine.begin_anew()
            for case in sorted(lost, key=lambda case: case.number):
                yield _alone(case, engine)


def _some(flying: Iterable[Future[Any]]) -> set[Future[Any]]:
    """Those that have ended, as soon as one has. It waits in pieces: the system may hand a signal to any thread, and
    Python raises what comes of it in the main one, which does not wake for it."""
    while not (ended := wait(flying, LOOK_S, FIRST_COMPLETED).done):
        pass
    return ended


def _submitted(cases: Iterable[Case], engine: Engine, flying: dict[Future[Any], Case]) -> list[Case]:
    """Send cases on their way; those that a dead engine did not take."""
    lost = []
    for case in cases:
        try:
            flying[engine.submit(timed, case.work, *case.arguments)] = case
        except (BrokenExecutor, RuntimeError, OSError):
            lost.append(case)
    return lost


def _alone(case: Case, engine: Engine) -> Ended:
    """A case with no other beside it."""
    for _ in range(TRIES):
        flying: dict[Future[Any], Case] = {}
        if not _submitted([case], engine, flying):
            found = _result(case, *_some(flying))
            if found is not None:
                return found
        engine.begin_anew()
    return Ended(case.number, None, f"the process that computed it died, {TRIES} times: killed, or out of memory?")


def _result(case: Case, future: Future[Any]) -> Ended | None:
    """What a case came to; None where its process died."""
    try:
        value, fault, seconds = future.result()
    except (BrokenExecutor, CancelledError):
        return None
    except Stopped:  # a signal that came while this was waiting: it comes once, and is nothing that the case came to
        raise
    except Exception as error:
        if type(error).__name__ in LOST:
            return None
        return Ended(case.number, None, f"could not be computed elsewhere ({type(error).__name__}: {error})")
    return Ended(case.number, value, fault, seconds)


def timed(work: Callable[..., Any], *arguments: Any) -> tuple[Any, str, float]:
    """In a worker: (value, fault, seconds). A case that fails in a way that nobody has foreseen fails alone."""
    began = time.perf_counter()
    try:
        value, fault = work(*arguments), ""
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        value, fault = None, f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})"
    return value, fault, time.perf_counter() - began
