"""A bench's plant that no part of `sim` wrote, behind the emulated instruments: what such plants share.

A plant moves by Euler steps in `_run`, and answers at the moments at which instruments have asked to be told
(`schedule`). `behind_the_instruments` puts plants in the simulator's place; `noted_phase` notes when a phase begins.
"""

from __future__ import annotations

import contextlib
import heapq
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any

STEP_S = 0.02
KELVIN = 273.15

SIMULATED_BENCH = """
[bench]
time = "virtual"
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
"""


class OwnPlant(ABC):
    """The plant's side of `sim.instruments.instrument.Plant`, but for what is the plant's own."""

    def __init__(self, start_s: float) -> None:
        self.time_s = start_s
        self.current_A = self.test_current_A = 0.0
        self._due: list[tuple[float, int, Callable[[float], None]]] = []
        self._count = 0

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (max(time_s, self.time_s), self._count, callback))

    def advance_to(self, time_s: float) -> None:
        while self._due and self._due[0][0] <= time_s:
            due_s, _, callback = heapq.heappop(self._due)
            self._run(due_s)
            callback(due_s)
        self._run(time_s)

    def set_test_current_A(self, current_A: float) -> None:
        """Kept; the film is not heated by it."""
        self.test_current_A = current_A

    def read_voltage_V(self) -> float:
        return 0.0

    @abstractmethod
    def _run(self, until_s: float) -> None: ...


@contextlib.contextmanager
def behind_the_instruments(made: Callable[[float], Any]) -> Iterator[list[Any]]:
    """Every simulated bench gets a plant that `made` makes for its first moment (s); those made so far, in order."""
    import rig.bench.assembly

    plants: list[Any] = []

    def world(_: Any, start_s: float) -> Any:
        plants.append(made(start_s))
        return plants[-1]

    before, rig.bench.assembly.SimulatedPlant = rig.bench.assembly.SimulatedPlant, world  # type: ignore[assignment,misc]
    try:
        yield plants
    finally:
        rig.bench.assembly.SimulatedPlant = before  # type: ignore[misc]


@contextlib.contextmanager
def noted_phase(is_it: Callable[[str], bool]) -> Iterator[list[float]]:
    """When the phases began whose name is the one asked for, by the loop's clock: a plant is behind it, for it is moved
    when somebody asks for it."""
    from rig.control.loop import Loop

    begin_s: list[float] = []
    whole = Loop._phase

    def noting(self: Loop, name: str, *rest: Any) -> None:
        if is_it(name):
            begin_s.append(self.bench.clock.now_s())
        whole(self, name, *rest)

    Loop._phase = noting  # type: ignore[method-assign]
    try:
        yield begin_s
    finally:
        Loop._phase = whole  # type: ignore[method-assign]
