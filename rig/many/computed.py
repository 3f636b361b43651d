"""Cases from the choice of an engine to their end: each is taken up as it ends, and a signal ends them all."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rig.many.cases import Case, Ended, each_ended
from rig.many.engine import Engine, EngineChoice, opened
from rig.many.journal import LOST, Journal
from rig.safety.signals import SignalStop


def compute(
    cases: Callable[[Engine], Iterable[Case]], count: int, choice: EngineChoice, take: Callable[[Ended], None]
) -> None:
    """Those that `cases` makes for the engine, `count` at the most. Raises Faults, Stopped."""
    with SignalStop(), opened(choice, max(count, 1)) as engine:
        for ended in each_ended(cases(engine), engine):
            take(ended)


def compute_missing(
    journal: Journal,
    cases: Callable[[Engine, list[int]], Iterable[Case]],
    choice: EngineChoice,
    tell: Callable[[int, int, dict[str, Any]], None],
) -> None:
    """What the journal misses, into it, and close it; cases(engine, numbers) makes them, whose values are rows;
    tell(done, of, row) as each ends. Raises Faults, Stopped."""
    left = journal.missing()

    def take(ended: Ended) -> None:
        values = ended.value if not ended.fault else {"status": LOST, "text": ended.fault}
        journal.add(ended.number, values, ended.seconds)
        tell(len(journal.done), journal.count, {**journal.case(ended.number), **values})

    try:
        compute(lambda engine: cases(engine, left), len(left), choice, take)
    finally:
        journal.close()
