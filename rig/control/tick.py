"""A tick as it was, and how punctual all of them were."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rig.control.decision import Decision
from rig.core.reading import Reading
from rig.safety.bench_watch import BenchWatch


@dataclass
class Ticks:
    """How punctual the loop was: ticks done, ticks missed, largest lateness (s).

    gaps: times without a reading for more than `rig.control.loop.GAP_S` with a current on; unwatched_s: the longest
    time without a reading with a current on. unacknowledged: ticks whose command the controller did not acknowledge.
    """

    done: int = 0
    missed: int = 0
    latest_s: float = 0.0
    gaps: int = 0
    unwatched_s: float = 0.0
    unacknowledged: int = 0


Progress = Callable[[str, float, float], None]  # phase, seconds done, seconds in all


@dataclass(frozen=True)
class Tick:
    """One tick as it was: time of the run (s), readings with quality, the ohmmeter's test current at its reading, what
    was sent (nan: nothing of it), the watch."""

    time_s: float
    phase: str
    temperature: Reading
    resistance: Reading | None
    test_current_A: float
    current_A: float
    decision: Decision
    watch: BenchWatch
