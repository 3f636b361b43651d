"""What an effect is: one link of the signal chain that departs from its plain form, written once.

The simulator switches an effect on with values for its parameters; the diagnosis fits the same values. An effect
departs in one of these forms; `par` is always the array of its parameters in their order, shape (parameters,).

    Command         driver: what becomes of a current commanded at a time
    HeatFlow        plate: a term of the heat balance, with a temperature of its own if it has one, or the ambient's
    Filter          thermometer, film, ohmmeter: a signal that follows another with a memory
    Warming         film: what is added to the plate's temperature
    Reading         thermometer, ohmmeter: what an instrument shows for a value
    ReadingTime     ohmmeter: when the value that is stamped t was taken

An effect of a user's own is one file with an `EFFECT` in it (`docs/own_effect.md`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array

Link = Literal["driver", "plate", "thermometer", "film", "ohmmeter"]
LINKS: tuple[Link, ...] = ("driver", "plate", "thermometer", "film", "ohmmeter")


@dataclass(frozen=True)
class Parameter:
    """One parameter: its name ends in the unit. smallest, largest: the usual sizes, > 0 (`signed`: of either sign).

    choices: the values that it can have, where it is not any number between them.
    """

    name: str
    smallest: float
    largest: float
    signed: bool = False
    choices: tuple[float, ...] = ()


@dataclass(frozen=True)
class Command:
    """send(par, time_s, current_A) -> (when it acts, what acts); arrays of shape (commands,).

    jumps(current_A): the values of the (only) parameter at which the outcome jumps, with nothing in between them, where
    it does; such a parameter has to be searched for.
    """

    send: Callable[[Array, Array, Array], tuple[Array, Array]]
    jumps: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class HeatFlow:
    """Terms of the heat balance, as compiled functions of

        (p0, p1, s, r, g, ambient_degC, time_s, plate_degC, own_degC, current_A)

    plate_rate: what is added to dT_p/dt, K/s. own_rate: d(own temperature)/dt, K/s, where the effect has one.
    ambient: what is added to the ambient, K. p0, p1: the effect's parameters (at most two); s, r, g: S/C, R_e/C, G/C;
    where S and R_e change with temperature, R_e is the plate's, and S is that at the plate's temperature, for own_rate
    at the effect's own.
    """

    plate_rate: Any = None
    own_rate: Any = None
    ambient: Any = None


@dataclass(frozen=True)
class Filter:
    """run(par, time_s, values, state, out): out follows values; state, shape (1,), is where it is, in and out.

    target: the thermometer's temperature, the film's temperature, the film's hysteretic part, or log R.
    columns(par, time_s, values, out): the same for every column of values, (nodes, columns), at rest before the first
    node; None: `run` takes one after the other.
    """

    run: Any
    target: Literal["thermometer", "film_temperature", "hysteretic_part", "log_resistance"]
    columns: Any = None


@dataclass(frozen=True)
class Warming:
    """add(par, time_s, power_W): K added to the plate's temperature; time from the first row on, power of the
    ohmmeter in the film, I_m^2 R. heated: whether the power matters."""

    add: Callable[[Array, Array, Array], Array]
    heated: bool = False


@dataclass(frozen=True)
class Reading:
    """read(par, values) -> what is shown; degC for a thermometer, ohm for an ohmmeter.

    linear: log10 of what is shown is that of the value plus a linear function of the last parameter.
    rounding: readings are quantized.
    """

    read: Callable[[Array, Array], Array]
    linear: bool = False
    rounding: bool = False


@dataclass(frozen=True)
class ReadingTime:
    """taken(par, time_s) -> when the value stamped time_s was taken."""

    taken: Callable[[Array, Array], Array]


Form = Command | HeatFlow | Filter | Warming | Reading | ReadingTime


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue. order: of effects on the same link, the smaller one first along the chain.

    inverse: whether a larger first parameter means less of the effect.
    changes: what is different, in words for a report. remedy: what a bench does about it, or how to separate it.
    """

    name: str
    link: Link
    parameters: tuple[Parameter, ...]
    form: Form
    changes: str
    remedy: str
    order: int = 0
    inverse: bool = False

    @property
    def before_film(self) -> bool:
        """Whether it acts before the film: current and thermometer tell of it, and a film driven by the thermometer's
        readings does not."""
        return self.link in ("driver", "plate", "thermometer")

    def array(self, values: dict[str, float]) -> Array:
        """Return the parameters in their order. Raises ValueError for a name or a value that cannot be."""
        names = [p.name for p in self.parameters]
        for name in values:
            if name not in names:
                raise ValueError(f"{self.name}: no parameter {name!r}; expected {', '.join(names)}")
        for p in self.parameters:
            if p.name not in values:
                raise ValueError(f"{self.name}: {p.name}: missing; expected a number")
            value = values[p.name]
            if not np.isfinite(value) or (not p.signed and value < 0.0):
                raise ValueError(
                    f"{self.name}: {p.name}: {value!r}: expected a finite number{'' if p.signed else ' >= 0'}"
                )
        return np.array([values[name] for name in names], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Switched:
    """An effect with values: what a simulator has on, or a diagnosis tries."""

    effect: Effect
    par: Array

    @property
    def name(self) -> str:
        return self.effect.name

    def values(self) -> dict[str, float]:
        """Return parameters by name."""
        return {p.name: float(v) for p, v in zip(self.effect.parameters, self.par, strict=True)}


def pinned(effect: Effect, values: Mapping[str, float]) -> Effect:
    """Return the effect with these parameters known: no fit moves them. Raises ValueError for one that it does not
    have."""
    known = {p.name for p in effect.parameters}
    for name in values:
        if name not in known:
            raise ValueError(f"{effect.name}: no parameter {name!r}; expected {', '.join(sorted(known))}")
    parameters = tuple(replace(p, choices=(values[p.name],)) if p.name in values else p for p in effect.parameters)
    return replace(effect, parameters=parameters)


def with_pinned(effect: Effect, values: Sequence[float]) -> list[float]:
    """Return the values, with those that are known in their places."""
    return [p.choices[0] if len(p.choices) == 1 else v for p, v in zip(effect.parameters, values, strict=True)]


def jumps(effect: Effect) -> bool:
    """Whether the outcome jumps with the effect's parameter, so that it has to be searched for."""
    if not isinstance(effect.form, Command) or effect.form.jumps is None:
        return False
    return any(len(p.choices) != 1 for p in effect.parameters)


def at_the_terminals(effect: Effect) -> bool:
    """Whether it bends the reading as a function of the resistance alone."""
    return isinstance(effect.form, Reading) and effect.link == "ohmmeter" and not effect.form.linear


def of_resistances(effect: Effect) -> bool:
    """Whether an effect is defined on ohms: what an ohmmeter shows for a resistance, or what it heats."""
    form = effect.form
    return (effect.link == "ohmmeter" and isinstance(form, Reading)) or (isinstance(form, Warming) and form.heated)


def switched(effect: Effect, values: dict[str, float] | ArrayLike) -> Switched:
    """Return the effect with the given parameters. Raises ValueError."""
    if isinstance(values, dict):
        return Switched(effect, effect.array(values))
    return Switched(effect, np.array(values, dtype=np.float64))
