"""What belongs to a record and not to a model: the room, and what plate, sink, thermometer and film began with.

A model is a rig's and stays; the room's temperature, first temperatures and the film's memory are another day's. They
are fitted with every record by `sim.inference.nuisance`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from compensator.hysteresis.film import Initial
from compensator.hysteresis.functions import Array
from sim.model import gaps
from sim.model.film_side import Film
from sim.model.recorded import Recorded, Rows

SATURATED_DEGC = {"cooled": 1000.0, "heated": -270.0}  # where a film came from that is saturated wherever it begins
MOST_ANEW = 10  # long gaps after which what has a temperature of its own begins anew; with more of them it goes through


@dataclass(frozen=True)
class FilmStart:
    """A film's memory at the first row: saturation at one end ("cooled": the hot one), and the turning points since.

    turned_degC: these, in sequence. passed_degC: of each gap in which the film turned round, the time (s) of the row
    after it, and the temperatures at which it did, in sequence.
    """

    initial: Initial = "heated"
    turned_degC: tuple[float, ...] = ()
    passed_degC: tuple[tuple[float, tuple[float, ...]], ...] = ()

    def turned_in_gaps(self, time_s: Array) -> tuple[Rows, Array]:
        """Return the row before which the film was at each of those temperatures, and these, in sequence."""
        turned = [(int(np.searchsorted(time_s, t)), degC) for t, several in self.passed_degC for degC in several]
        rows = np.array([row for row, _ in turned], dtype=np.int64)
        return rows, np.array([degC for _, degC in turned], dtype=np.float64)

    def turning(self, end_s: float, passed_degC: tuple[float, ...]) -> FilmStart:
        """Return the memory with other temperatures in the gap that ends at a time; (): straight through it."""
        others = {time_s: degC for time_s, degC in self.passed_degC if time_s != end_s}
        if passed_degC:
            others[end_s] = passed_degC
        return replace(self, passed_degC=tuple(sorted(others.items())))

    def memory(self, film: Film) -> Any:
        """Return the memory of a film, before it comes to its first temperature."""
        first, *rest = self.turned_degC or (SATURATED_DEGC[self.initial],)
        memory = film.initial_memory(first, self.initial)
        for degC in rest:
            memory = film.step(degC, memory)[1]
        return memory


@dataclass(frozen=True, eq=False)
class RecordOwn:
    """ambient_degC: the room's temperature. plate_degC: where each stretch of rows begins, (stretches,).

    bodies_degC: of each body on the plate's balance with a temperature of its own, by effect; thermometer_late_K: by
    how much each filter of the thermometer is behind, by effect; both at the rows of `anew_rows`, (beginnings,). film:
    its memory at the first row; late: how far each filter of the film's temperature (K), of its hysteretic part and of
    log R (decades of -log10 R) is behind there, by effect. What is not named is at rest: at the room's temperature,
    and after a gap where it was, or behind by nothing.
    """

    ambient_degC: float
    plate_degC: Array
    bodies_degC: Mapping[str, Array] = field(default_factory=dict)
    thermometer_late_K: Mapping[str, Array] = field(default_factory=dict)
    film: FilmStart = field(default_factory=FilmStart)
    late: Mapping[str, float] = field(default_factory=dict)


def anew_rows(record: Recorded) -> Rows:
    """Return the first row, and those after gaps so long that bodies and thermometer begin anew, too."""
    long = long_gaps(record)
    return np.append(0, long if long.size <= MOST_ANEW else long[:0]).astype(np.int64)


def long_gaps(record: Recorded) -> Rows:
    """Return the rows after gaps in which a plate may have turned round."""
    return gaps.long_gaps(record.time_s, record.first_rows[1:])


def longest_gaps(record: Recorded) -> Rows:
    """Of those the rows after the longest ones, as many as are looked at."""
    after = long_gaps(record)
    return gaps.longest_of(after, record.time_s[after] - record.time_s[after - 1])
