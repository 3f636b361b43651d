"""A whole record from a current over time, or the film's side of it from a temperature over time: no instruments.

Rows come in with what was commanded, readings at these rows come out. The current of a row holds from its time to the
next row's; before the first it was 0. The ohmmeter's test current of a row flows since the row before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array
from sim.model.chain import LONGEST_NODE_S, Chain, ChainState, Stretch
from sim.world.world import World

MOST_NODES = 3_000_000
BLOCK = 4096  # nodes that are solved together


@dataclass(frozen=True, eq=False)
class Readings:
    """What the instruments show, one of each a row: degC and ohm; and the memory of the film at the end.

    output: -log10 of the resistance, or whatever else the film's output is.
    """

    temperature_degC: Array
    resistance_ohm: Array
    output: Array
    film_memory: Any


def simulate_record(
    world: World,
    time_s: Array,
    current_A: Array,
    *,
    meter_current_A: ArrayLike = 0.0,
    resistance_time_s: Array | None = None,
    restart_degC: Array | None = None,
    memory: Any = None,
    origin_s: float | None = None,
) -> Readings:
    """Readings of the rows, with the world's noise.

    resistance_time_s: what the resistances are stamped with, by default the rows' times. restart_degC: where finite the
    plate begins anew at that temperature (after a gap). memory: the film's at the first row, by default the world's.
    origin_s: when what drifts begins to, by default at the first row. Raises ValueError for effects that clash.
    """
    origin = float(time_s[0]) if origin_s is None else origin_s
    rows = np.asarray(time_s, dtype=np.float64) - origin
    chain = Chain(world.model)
    state = chain.start(world.first_degC, memory, world.film_initial)
    acts, amounts = chain.links.sent(rows, np.clip(current_A, -world.current_limit_A, world.current_limit_A))
    taken = _taken(chain, rows, resistance_time_s, origin)
    test = np.broadcast_to(np.asarray(meter_current_A, dtype=np.float64), rows.shape)
    starts = [0] if restart_degC is None else [0, *(np.flatnonzero(np.isfinite(restart_degC[1:])) + 1)]
    temperature, output = np.empty(rows.size), np.empty(rows.size)
    for begin, end in zip(starts, [*starts[1:], rows.size], strict=True):
        if restart_degC is not None and np.isfinite(restart_degC[begin]):
            assert state.film is not None
            state = replace(chain.start(float(restart_degC[begin]), state.film.memory), own_degC=state.own_degC)
        inside = slice(begin, end)
        last = float(np.nanmax(np.append(taken[inside], rows[end - 1]))) if end == rows.size else rows[end - 1]
        here = (acts >= rows[begin]) & (acts <= last)
        needed = taken[inside][(taken[inside] > rows[begin]) & (taken[inside] < last)]
        time = _nodes(chain, np.concatenate((rows[inside], acts[here], needed, [last])), rows, test)
        place = np.searchsorted(acts, time, side="right") - 1
        current = np.where(place >= 0, amounts[np.maximum(place, 0)], 0.0)
        course, state = _advanced(chain, state, time, current, _test_at(rows, test, time))
        temperature[inside] = np.interp(rows[inside], course.time_s, course.thermometer_degC)
        output[inside] = _at(taken[inside], course)
    return _read(world, chain, state, temperature, output)


def film_readings(
    world: World,
    time_s: Array,
    temperature_degC: Array,
    *,
    meter_current_A: ArrayLike = 0.0,
    resistance_time_s: Array | None = None,
    memory: Any = None,
) -> Readings:
    """The same where the plate's course is what a thermometer read, straight between rows: film and ohmmeter alone."""
    rows = np.asarray(time_s, dtype=np.float64) - float(time_s[0])
    known = np.isfinite(temperature_degC)
    first = float(np.asarray(temperature_degC)[known][0])
    chain = Chain(world.model)
    state = chain.start(first, memory, world.film_initial)
    taken = _taken(chain, rows, resistance_time_s, float(time_s[0]))
    test = np.broadcast_to(np.asarray(meter_current_A, dtype=np.float64), rows.shape)
    inside = taken[(taken > rows[0]) & (taken < rows[-1])]
    time = _nodes(chain, np.concatenate((rows, inside)), rows, test)
    plate = np.interp(time, rows[known], np.asarray(temperature_degC, dtype=np.float64)[known])
    course, state = _measured(chain, state, time, plate, _test_at(rows, test, time))
    return _read(world, chain, state, np.interp(rows, time, plate), _at(taken, course))


def _taken(chain: Chain, rows: Array, stamps: Array | None, origin: float) -> Array:
    """When the resistance was taken, from the origin on."""
    stamped = rows if stamps is None else np.where(np.isfinite(stamps), stamps - origin, rows)
    return chain.links.taken(stamped)


def _nodes(chain: Chain, needed: Array, rows: Array, test: Array) -> Array:
    """Times of the nodes: those needed, those in between, and twice where the test current changes."""
    time = np.unique(needed)
    if chain.links.fine:
        step = max(LONGEST_NODE_S, (time[-1] - time[0]) / MOST_NODES)
        count = np.maximum(np.ceil(np.diff(time) / step - 1e-9).astype(np.int64), 1)
        begin = np.repeat(time[:-1], count)
        length = np.repeat(np.diff(time) / count, count)
        within = np.arange(begin.size) - np.repeat(np.cumsum(count) - count, count)
        time = np.append(begin + within * length, time[-1])
    if chain.links.heated:
        changes = rows[:-1][test[1:] != test[:-1]]
        time = np.sort(np.concatenate((time, changes[(changes >= time[0]) & (changes <= time[-1])])))
    return time


def _test_at(rows: Array, test: Array, time: Array) -> Array:
    """The test current up to each node; of two nodes at one time the second has the next row's."""
    place = np.searchsorted(rows, time, side="left")
    second = np.append(False, np.diff(time) == 0.0)
    place = np.where(second, np.searchsorted(rows, time, side="right"), place)
    return np.asarray(test[np.minimum(place, rows.size - 1)], dtype=np.float64)


def _at(when: Array, course: Stretch) -> Array:
    """The output at these times; at a node of two, that of the first, before the test current changed."""
    place = np.minimum(np.searchsorted(course.time_s, when, side="left"), course.time_s.size - 1)
    between = np.interp(when, course.time_s, course.output)
    return np.where(course.time_s[place] == when, course.output[place], between)


def _advanced(chain: Chain, state: ChainState, time: Array, current: Array, test: Array) -> tuple[Stretch, ChainState]:
    """The chain over all nodes, block by block; a block begins with the last node of the one before."""
    parts = []
    for begin in range(0, max(time.size - 1, 1), BLOCK):
        part = slice(begin, min(begin + BLOCK + 1, time.size))
        stretch, state = chain.advance(state, time[part], current[part], test[part])
        parts.append((begin, stretch))
    return _joined(parts), state


def _measured(chain: Chain, state: ChainState, time: Array, plate: Array, test: Array) -> tuple[Stretch, ChainState]:
    parts = []
    for begin in range(0, max(time.size - 1, 1), BLOCK):
        part = slice(begin, min(begin + BLOCK + 1, time.size))
        stretch, state = chain.measure(state, time[part], plate[part], test[part])
        parts.append((begin, stretch))
    return _joined(parts), state


def _joined(parts: list[tuple[int, Stretch]]) -> Stretch:
    columns = []
    for name in Stretch.__dataclass_fields__:
        columns.append(np.concatenate([getattr(p, name) if not b else getattr(p, name)[1:] for b, p in parts]))
    return Stretch(*columns)


def _read(world: World, chain: Chain, state: ChainState, temperature: Array, output: Array) -> Readings:
    """Noise and what the instruments make of the values. The noise is that of `SimulatedPlant`'s seed."""
    links = chain.links
    thermometer, ohmmeter = np.random.default_rng(world.seed).spawn(2)
    degC = links.shown_degC(temperature + world.thermometer_noise_K * thermometer.standard_normal(temperature.size))
    if links.readings:
        output = -np.log10(links.shown_ohm(10.0**-output))
    output = output - world.ohmmeter_noise_dec * ohmmeter.standard_normal(output.size)
    assert state.film is not None
    return Readings(degC, 10.0**-output, output, state.film.memory)
