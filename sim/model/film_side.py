"""Plate temperature -> film -> ohmmeter's input, node by node, with any effects of film and ohmmeter.

A stretch of nodes comes in, -log10 of the resistance at each comes out; the state stands at the last node. The next
stretch begins with that node. A film that the ohmmeter heats needs its own resistance to know its temperature:

    T_f = g(T_f),   g = warmings of the plate's temperature by I_m^2 R(T_f)

which is solved for all nodes of the stretch at once (secant steps, each node with its own slope), and node by node in
a bracket where that does not settle. Each trial begins with the memory at the first node, so that no trial is
remembered.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis.film import Memoryless
from compensator.hysteresis.functions import Array, memoryless_value
from sim.effects.effect import Filter, Switched
from sim.model.links import Links, followed, shown_output, warmed

CLOSE_K = 1e-9  # a thousandth of what the chain is compared to
PASSES = 30  # secant steps gain a digit or more each; where they do not, a bracket is sure to
STEEPEST = 100.0  # of g: kelvin of heating lost per kelvin
BISECTIONS = 60


class Film(Protocol):
    """A film as the world needs it: memory in, memory out; memoryless: its D(T)."""

    @property
    def memoryless(self) -> Memoryless: ...

    def simulate(self, inputs_degC: Any, memory: Any) -> tuple[Any, Any]: ...

    def step(self, input_degC: float, memory: Any) -> tuple[float, Any]: ...

    def initial_memory(self, input_degC: float, initial: Any = ...) -> Any: ...


@dataclass(frozen=True, eq=False)
class FilmState:
    """What film and ohmmeter remember: play operators or relays, and where each filter is (nan: not begun yet; then it
    begins `late` behind, by effect: K of the film's temperature, decades of -log10 R; nothing: at rest)."""

    memory: Any
    temperature_filters: tuple[Array, ...]
    output_filters: tuple[Array, ...]
    ohmmeter_filters: tuple[Array, ...]
    late: Mapping[str, float] = field(default_factory=dict)


@njit
def _memoryless(code: int, par: Array, inputs: Array) -> Array:
    out = np.empty(inputs.size)
    for k in range(inputs.size):
        out[k] = memoryless_value(code, par, inputs[k])
    return out


class FilmSide:
    """A film with the effects on it and on what measures it. It remembers nothing: see `FilmState`."""

    def __init__(self, film: Film, links: Links) -> None:
        self._film = film
        self._links = links
        self._code, self._par = film.memoryless.code, film.memoryless.array()

    def start(self, memory: Any, late: Mapping[str, float] | None = None) -> FilmState:
        """Return the state with the given memory, each filter behind by `late`, what is not named as if all had been
        constant before."""
        links = self._links
        filters = _unset(links.film_temperature), _unset(links.hysteretic_part), _unset(links.ohmmeter)
        return FilmState(memory, *filters, late or {})

    def advance(
        self,
        state: FilmState,
        time_s: Array,
        plate_degC: Array,
        test_current_A: Array,
        power_W: Array | None = None,
    ) -> tuple[Array, Array, Array, FilmState]:
        """Return (film's temperature in degC, -log10 of its own R, the same at the ohmmeter, state at the last node);
        arrays of shape (nodes,).

        time_s counts from the record's first row; test_current_A: up to each node; power_W: what the ohmmeter heats
        with, None: by the film's own resistance.
        """
        none = np.zeros(time_s.size)
        film_degC, temperature_filters = self._warmed(state, time_s, plate_degC, none if power_W is None else power_W)
        if power_W is None and self._links.heated and np.any(test_current_A != 0.0):
            film_degC = self._heated(state, time_s, plate_degC, test_current_A, film_degC)
            power = self._power(state, time_s, film_degC, test_current_A)
            _, temperature_filters = self._warmed(state, time_s, plate_degC, power)
        output, memory, output_filters = self._respond(state, time_s, film_degC)
        shown, ohmmeter_filters = self._ohmmeter(state, time_s, output)
        return film_degC, output, shown, FilmState(memory, temperature_filters, output_filters, ohmmeter_filters)

    def _warmed(
        self, state: FilmState, time_s: Array, plate_degC: Array, power_W: Array
    ) -> tuple[Array, tuple[Array, ...]]:
        values, filters = plate_degC, []
        for e, before in zip(self._links.film_temperature, state.temperature_filters, strict=True):
            after = before
            if isinstance(e.effect.form, Filter):
                values, after = followed(e, time_s, values, before, state.late.get(e.name, 0.0))
            else:
                values = warmed(e, time_s, values, power_W)
            filters.append(after)
        return values, tuple(filters)

    def _respond(self, state: FilmState, time_s: Array, film_degC: Array) -> tuple[Array, Any, tuple[Array, ...]]:
        output, memory = self._film.simulate(film_degC, state.memory)
        if not self._links.hysteretic_part:
            return output, memory, state.output_filters
        memoryless = _memoryless(self._code, self._par, film_degC)
        part, filters = output - memoryless, []
        for e, before in zip(self._links.hysteretic_part, state.output_filters, strict=True):
            part, after = followed(e, time_s, part, before, state.late.get(e.name, 0.0))
            filters.append(after)
        return memoryless + part, memory, tuple(filters)

    def _ohmmeter(self, state: FilmState, time_s: Array, output: Array) -> tuple[Array, tuple[Array, ...]]:
        filters = []
        for e, before in zip(self._links.ohmmeter, state.ohmmeter_filters, strict=True):
            after = before
            if isinstance(e.effect.form, Filter):
                log_R, after = followed(e, time_s, -output, before, -state.late.get(e.name, 0.0))
                output = -log_R
            else:
                output = shown_output(e, output)
            filters.append(after)
        return output, tuple(filters)

    def _power(self, state: FilmState, time_s: Array, film_degC: Array, test_current_A: Array) -> Array:
        """Return what the ohmmeter heats the film with, W."""
        return np.asarray(test_current_A**2 * 10.0 ** -self._respond(state, time_s, film_degC)[0], dtype=np.float64)

    def _next(self, state: FilmState, time_s: Array, plate: Array, test: Array, film_degC: Array) -> Array:
        """Return g: the film's temperature for the resistance that it has at film_degC."""
        return self._warmed(state, time_s, plate, self._power(state, time_s, film_degC, test))[0]

    def _heated(self, state: FilmState, time_s: Array, plate: Array, test: Array, cold: Array) -> Array:
        x = cold
        gx = self._next(state, time_s, plate, test, x)
        slope = np.zeros(x.size)
        for _ in range(PASSES):
            if np.max(np.abs(gx - x)) < CLOSE_K:
                return gx
            step = (gx - x) / (1.0 - slope)
            following = x + step
            g_next = self._next(state, time_s, plate, test, following)
            moved = np.abs(step) > 1e-12
            slope = np.where(moved, (g_next - gx) / np.where(moved, step, 1.0), slope)
            slope = np.clip(slope, -STEEPEST, 0.5)
            x, gx = following, g_next
        return self._one_by_one(state, time_s, plate, test)

    def _one_by_one(self, state: FilmState, time_s: Array, plate: Array, test: Array) -> Array:
        """Return the same with a bracket at each node, in the order of time."""
        found = np.empty(time_s.size)
        for k in range(time_s.size):
            first = max(k - 1, 0)
            t, p, i = time_s[first : k + 1], plate[first : k + 1], test[first : k + 1]
            x = np.append(found[first:k], 0.0)
            low = float(self._warmed(state, t, p, np.zeros(t.size))[0][-1])
            x[-1] = low
            high = float(self._next(state, t, p, i, x)[-1])
            for _ in range(BISECTIONS):  # where the resistance rises with temperature
                x[-1] = high
                if float(self._next(state, t, p, i, x)[-1]) <= high:
                    break
                high = low + 2.0 * (high - low)
            for _ in range(BISECTIONS):
                x[-1] = 0.5 * (low + high)
                g = float(self._next(state, t, p, i, x)[-1])
                if g > x[-1]:
                    low = x[-1]
                else:
                    high = x[-1]
                if high - low < CLOSE_K:
                    break
            x[-1] = high
            found[k] = high
            power = self._power(state, t, x, i)
            _, filters = self._warmed(state, t, p, power)
            _, memory, output_filters = self._respond(state, t, x)
            state = FilmState(memory, filters, output_filters, state.ohmmeter_filters, state.late)
        return found


def _unset(effects: Sequence[Switched]) -> tuple[Array, ...]:
    return tuple(np.full(1, np.nan) for _ in effects)
