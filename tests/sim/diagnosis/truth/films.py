"""A film: hysteretic part, memoryless part D(T), memory at the start; and how its parameters can be varied."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.hysteresis import COLD, DEEPEST, HOT, MIXED, MOVING, PLAY, REVERSAL, film_path, share

Array = NDArray[np.float64]
FORMS = ("none", "linear", "arrhenius", "tanh")


@dataclass(frozen=True)
class Film:
    """kind and table as in `hysteresis`; form and d as in `hysteresis.memoryless`; before: temperatures that the film
    went through before the record, from saturation on."""

    kind: int
    table: Array
    form: int
    d: Array
    before: tuple[float, ...]
    name: str

    def memory(self) -> Array:
        """The state after the temperatures in `before`."""
        if self.kind == REVERSAL:
            state = np.zeros(3 + 2 * (DEEPEST + 2))
            hot = self.before[0] > 60.0
            first, second = (COLD, HOT) if hot else (HOT, COLD)
            state[:3] = 2.0, second, float(hot)
            state[3:7] = first, float(not hot), second, float(hot)
        elif self.kind == PLAY:
            state = np.zeros(self.count)
        else:
            state = np.full(self.count, self.before[0])
        for there in self.before:
            share(self.kind, self.table, state, there, state)
        return state

    @property
    def count(self) -> int:
        """How many operators, widths or curves carry the memory."""
        return int(np.count_nonzero(self.table[1])) if self.kind != REVERSAL else 1

    def log_ohm(self, temperature_degC: Array) -> Array:
        """log10 R along a path of temperatures, without any effect."""
        time = np.arange(float(temperature_degC.size))
        film = (self.kind, self.table, self.memory(), self.form, self.d)
        return film_path(*film, time, temperature_degC, np.zeros(time.size), 0.0, 1.0)

    def changed(self, row: int, columns: slice | Array | int, change: Array | float) -> Film:
        """The film with part of its table moved."""
        table = self.table.copy()
        table[row, columns] += change
        return replace(self, table=table)

    def neighbours(self) -> Iterator[tuple[Film, float]]:
        """Films a small step away, one for each direction that a free fit of this film has, with the step."""
        moved = {0: (), 1: (0,), 2: (0,), 3: (0, 1, 2)}[self.form]
        for index in (*moved, 3):
            step = (2e-3, 2e-6, 1e-4, 1e-4)[index]
            d = self.d.copy()
            d[index] += step * (abs(d[0]) if index == 0 else 1.0)
            yield replace(self, d=d), step
        if self.form == 0:  # a fit does not know that there is no D: a slope is free
            yield replace(self, form=1, d=np.array([1e-5, 0.0, 0.0, self.d[3]])), 1e-5
        yield from self._of_the_table()

    def _of_the_table(self) -> Iterator[tuple[Film, float]]:
        n = self.count
        if self.kind == PLAY:
            for first in (0, 2):
                a, b = self.table[2, first], self.table[2, first + 1]
                yield self.changed(2, first + 1, -1e-3 * a), 1e-3  # centre
                yield self.changed(2, slice(first, first + 2), 1e-3 * np.array([a, b])), 1e-3  # width
            for j in range(n):
                yield self.changed(1, j, 1e-3 * self.table[1, j]), 1e-3
            for group in np.array_split(np.argsort(self.table[0, :n]), 8):
                if group.size:
                    yield self.changed(0, group, 1e-4), 1e-4
        elif self.kind != REVERSAL:
            if self.kind == MOVING:
                yield self.changed(4, 0, 1e-3), 1e-3
            if self.kind == MIXED:
                yield self.changed(4, 0, 1e-4), 1e-4
                yield self.changed(5, 0, 1.0), 1.0
            for row, step in ((0, 2e-3), (2, 2e-3), (3, 2e-3)):
                for group in np.array_split(np.argsort(self.table[0, :n]), 6):
                    yield self.changed(row, group, step), step
            for group in np.array_split(np.argsort(self.table[0, :n]), 12):
                yield self.changed(1, group, 1e-3 * self.table[1, group]), 1e-3
        else:
            for row in (0, 1):
                for column in range(5):
                    yield self.changed(row, column, 1e-4), 1e-4
            for column in range(3):
                yield self.changed(2, column, 1e-4), 1e-4

    def operators_between(self, extra: int = 16) -> Iterator[tuple[Film, float]]:
        """The film with a small operator more, at radii that it does not have."""
        if self.kind != PLAY:
            return
        n, step = self.count, 1e-4
        for radius in np.linspace(self.table[0, :n].min(), 0.97, extra):
            table = np.zeros((3, n + 1))
            table[:, :n] = self.table[:, :n]
            table[2] = 0.0
            table[2, :4] = self.table[2, :4]
            table[0, n], table[1, n] = radius, step
            yield replace(self, table=table), step
