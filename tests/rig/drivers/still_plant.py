"""A world for tests: what the instruments read is what the test has put there."""

from __future__ import annotations

import heapq
from collections.abc import Callable


class StillPlant:
    """Temperature and resistance stay; what the instruments command is written down, with its time."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self.temperature_degC = 25.0
        self.sink_degC = 20.0
        self.resistance_ohm = 1e4
        self.voltage_V = 0.0
        self.current_A = 0.0
        self.test_current_A = 0.0
        self.currents: list[tuple[float, float]] = []
        self.heating_K_per_A_s = 0.0
        self.sampled_s = 0.0
        self._due: list[tuple[float, int, Callable[[float], None]]] = []
        self._count = 0

    def advance_to(self, time_s: float) -> None:
        while self._due and self._due[0][0] <= time_s:
            due_s, _, callback = heapq.heappop(self._due)
            self._move(due_s)
            callback(due_s)
        self._move(time_s)

    def _move(self, time_s: float) -> None:
        if time_s > self.time_s:
            self.temperature_degC += self.heating_K_per_A_s * self.current_A * (time_s - self.time_s)
            self.time_s = time_s

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (max(time_s, self.time_s), self._count, callback))

    def set_current_A(self, current_A: float) -> None:
        self.current_A = current_A
        self.currents.append((self.time_s, current_A))

    def read_temperature_degC(self) -> float:
        return self.temperature_degC

    def sink_temperature_degC(self) -> float:
        return self.sink_degC

    def read_resistance_ohm(self, test_current_A: float) -> float:
        self.sampled_s = self.time_s
        return self.resistance_ohm

    def read_voltage_V(self) -> float:
        self.sampled_s = self.time_s
        return self.voltage_V

    def set_test_current_A(self, test_current_A: float) -> None:
        self.test_current_A = test_current_A
