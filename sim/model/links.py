"""The links of the signal chain with the effects that are switched on, in the order in which the signal meets them.

    driver          commands
    plate           heat flows
    thermometer     filters, then noise, then readings
    film            filters and warmings of its temperature, then filters of its hysteretic part
    ohmmeter        series resistance, shunt, filter, skew, range: readings up to the last filter as R changes, those
                    after it when a value is taken

Whatever order effects are given in, `links_of` puts them into this one: link by link, on a link by `Effect.order`,
then by name.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import (
    Command,
    Effect,
    Filter,
    HeatFlow,
    Reading,
    ReadingTime,
    Switched,
    Warming,
    at_the_terminals,
)

Effects = tuple[Switched, ...]


@dataclass(frozen=True)
class Links:
    """Effects by link. ohmmeter: on R as it changes; reading_times, readings: when a reading is taken.

    fine: whether the course between two changes of the current matters, so that nodes lie close.
    """

    commands: Effects = ()
    plate: Effects = ()
    thermometer: Effects = ()
    temperature_readings: Effects = ()
    film_temperature: Effects = ()
    hysteretic_part: Effects = ()
    ohmmeter: Effects = ()
    reading_times: Effects = ()
    readings: Effects = ()

    @property
    def fine(self) -> bool:
        filters = (*self.thermometer, *self.film_temperature, *self.hysteretic_part, *self.ohmmeter)
        return bool(self.plate or filters or self.reading_times)

    @property
    def heated(self) -> bool:
        """Whether the ohmmeter's power in the film matters."""
        return any(isinstance(e.effect.form, Warming) and e.effect.form.heated for e in self.film_temperature)

    @property
    def film_lags(self) -> Effects:
        """The filters of the film's temperature."""
        return tuple(e for e in self.film_temperature if isinstance(e.effect.form, Filter))

    @property
    def meter_lags(self) -> Effects:
        """The filters of log R."""
        return tuple(e for e in self.ohmmeter if isinstance(e.effect.form, Filter))

    @property
    def bends(self) -> bool:
        """Whether what is shown is a curved function of the resistance: leads or a shunt."""
        return any(at_the_terminals(e.effect) for e in (*self.ohmmeter, *self.readings))

    @property
    def linear(self) -> bool:
        """Whether what is shown is linear in the film's own output, through filters alone."""
        return not self.bends and not self.readings

    def sent(self, time_s: Array, current_A: Array) -> tuple[Array, Array]:
        """Return when commands act, and what acts; in the order of time."""
        for e in self.commands:
            assert isinstance(e.effect.form, Command)
            time_s, current_A = e.effect.form.send(e.par, time_s, current_A)
        order = np.argsort(time_s, kind="stable")
        return time_s[order], current_A[order]

    def taken(self, time_s: Array) -> Array:
        """Return when the resistances that are stamped with these times were taken."""
        for e in reversed(self.reading_times):
            assert isinstance(e.effect.form, ReadingTime)
            time_s = e.effect.form.taken(e.par, time_s)
        return time_s

    def shown_degC(self, values: Array) -> Array:
        """Return what the thermometer shows for its own temperature with noise."""
        return _shown(self.temperature_readings, values)

    def shown_ohm(self, values: Array) -> Array:
        """Return what the ohmmeter shows for what it took."""
        return _shown(self.readings, values)

    def own_number(self, name: str) -> int | None:
        """Return the place of the effect on the plate with this name."""
        return next((k for k, e in enumerate(self.plate) if e.name == name), None)


def followed(effect: Switched, time_s: Array, values: Array, state: Array, late: float = 0.0) -> tuple[Array, Array]:
    """Return (what a filter makes of values at the nodes, (nodes,), where it is at the last one); state: where it is at
    the first node, (1,), nan: `late` behind the first value."""
    form, out = effect.effect.form, np.empty(values.size)
    assert isinstance(form, Filter)
    after = state.copy() if late == 0.0 or not math.isnan(state[0]) else values[:1] - late
    form.run(effect.par, time_s, np.ascontiguousarray(values), after, out)
    return out, after


def columns_followed(effect: Switched, time_s: Array, columns: Array) -> Array:
    """Return columns, (nodes, columns), through a filter that was at rest before the first node."""
    form = effect.effect.form
    assert isinstance(form, Filter)
    if form.columns is not None:
        together = np.empty(columns.shape)
        form.columns(effect.par, time_s, np.ascontiguousarray(columns), together)
        return together
    out = np.empty(columns.shape[::-1])  # in C order: a filter is compiled for one
    for k, column in enumerate(np.ascontiguousarray(columns.T)):
        form.run(effect.par, time_s, column, np.array([column[0]]), out[k])
    return np.ascontiguousarray(out.T)


def behind(effect: Switched, time_s: Array) -> Array:
    """Return what a filter adds to its signal when it is 1 behind at the first node, (nodes, 1)."""
    return followed(effect, time_s, np.zeros(time_s.size), np.array([-1.0]))[0][:, None]


def warmed(effect: Switched, time_s: Array, film_degC: Array, power_W: Array) -> Array:
    """Return the film's temperature with what an effect adds to it. power_W: of the ohmmeter in the film."""
    form = effect.effect.form
    assert isinstance(form, Warming)
    return np.asarray(film_degC + form.add(effect.par, time_s, power_W), dtype=np.float64)


def delays_s(effect: Effect, par: Array, time_s: Array, current_A: Array) -> Array:
    """Return how much later than commanded each current acts; 0 for an effect that moves no command."""
    if not isinstance(effect.form, Command):
        return np.zeros(1)
    return np.asarray(effect.form.send(par, time_s, current_A)[0] - time_s, dtype=np.float64)


def stamps_off_s(effect: Effect, par: Array, time_s: Array) -> Array:
    """Return how much later than stamped each value was taken; 0 for an effect that moves no stamp."""
    if not isinstance(effect.form, ReadingTime):
        return np.zeros(1)
    return np.asarray(effect.form.taken(par, time_s) - time_s, dtype=np.float64)


def shown_output(effect: Switched, output: Array) -> Array:
    """Return -log10 of the resistance that an effect of the ohmmeter shows for -log10 of another."""
    form = effect.effect.form
    assert isinstance(form, Reading)
    return np.asarray(-np.log10(form.read(effect.par, 10.0**-output)), dtype=np.float64)


def _shown(effects: Effects, values: Array) -> Array:
    for e in effects:
        assert isinstance(e.effect.form, Reading)
        values = e.effect.form.read(e.par, values)
    return values


def links_of(effects: Sequence[Switched]) -> Links:
    """Return the effects in their order. Raises ValueError for an effect twice, or of a form that its link does not
    have."""
    if not effects:  # as of every base model, asked for in each of its trials
        return Links()
    names = [e.name for e in effects]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name}: switched on twice")
    ordered = sorted(effects, key=lambda e: (e.effect.order, e.name))
    found: dict[str, list[Switched]] = {name: [] for name in Links.__dataclass_fields__}
    last_filter = max((e.effect.order for e in ordered if _target(e) == "log_resistance"), default=-math.inf)
    for e in ordered:
        form, link = e.effect.form, e.effect.link
        if isinstance(form, Command) and link == "driver":
            found["commands"].append(e)
        elif isinstance(form, HeatFlow) and link == "plate":
            found["plate"].append(e)
        elif isinstance(form, Filter):
            place = form.target if form.target != "log_resistance" else "ohmmeter"
            found[place].append(e)
        elif isinstance(form, Warming) and link == "film":
            found["film_temperature"].append(e)
        elif isinstance(form, Reading) and link == "thermometer":
            found["temperature_readings"].append(e)
        elif isinstance(form, Reading) and link == "ohmmeter":
            found["ohmmeter" if e.effect.order <= last_filter else "readings"].append(e)
        elif isinstance(form, ReadingTime) and link == "ohmmeter":
            found["reading_times"].append(e)
        else:
            raise ValueError(f"{e.name}: the link {link!r} has no effects of the form {type(form).__name__}")
    return Links(**{name: tuple(chosen) for name, chosen in found.items()})


def _target(effect: Switched) -> str | None:
    form = effect.effect.form
    return form.target if isinstance(form, Filter) else None
