"""A model as a law takes it: the unit that it works in, and what the model's [[effects]] come to.

A law of a resistance works in -log10(R / 1 ohm), or in log10 for a film whose resistance rises. What it takes of a
film before it knows better (noise, the model's error, how far the output goes before that is another) holds for a film
of two decades. Another output, such as a curvature of 1500 1/m, is scaled to that span: the law is the same one.

A law with effects is the same law with the chain's observer (`compensator.control.law.Observer`, `sim.model.observer`).
Laws without a model ("pid") and without a current ("instrument_pid") gain nothing from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, overload

import numpy as np

from compensator.control.law_step import LawName
from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from rig.config.target import Target
from rig.records.film_output import FALLING_RESISTANCE, column_of, in_decades, output_to_ohm, sign_of, unit_of
from rig.safety.plate_watch import KnownPlate
from sim.effects.effect import Switched
from sim.model.chain import ChainModel
from sim.model.links import links_of
from sim.model.observer import Observer, own_output_table

LAW_SPAN: Final = 2.0  # of a film's major loop, in the law's unit: the decades of a usual VO2 film


@dataclass(frozen=True)
class LawUnits:
    """Units of a law's output.

    quantity: of the target, "resistance" or the meter's column. factor: the law's output over the meter's, which is
    -log10(R / 1 ohm) or the column's value.
    """

    quantity: str
    factor: float

    @overload
    def law(self, metered: float) -> float: ...
    @overload
    def law(self, metered: Array) -> Array: ...
    def law(self, metered: float | Array) -> float | Array:
        """Return a meter's or target's value in the law's unit."""
        return self.factor * metered

    def shown(self, output: float) -> float:
        """Return the law's output in ohm, or in the column's unit."""
        metered = output / self.factor
        return output_to_ohm(metered, FALLING_RESISTANCE) if self.quantity == "resistance" else metered

    def in_words(self, output: float) -> str:
        """Return the law's output as a text with its unit."""
        return f"{self.shown(output):.6g} {self.unit}"

    @property
    def unit(self) -> str:
        """Return the unit of what is shown."""
        return "ohm" if self.quantity == "resistance" else unit_of(self.quantity)


def plain_units(film: FilmModel | None) -> LawUnits:
    """Return the units of a law whose film is as its model has it; those of a resistance if there is no film."""
    output = film.output if film is not None else FALLING_RESISTANCE
    if in_decades(output):
        return LawUnits("resistance", -sign_of(output))
    return LawUnits(column_of(output), sign_of(output))


def law_units(film: FilmModel, limits_degC: tuple[float, float]) -> LawUnits:
    """Return the units of a law of this film, between these temperatures."""
    units = plain_units(film)
    if units.quantity == "resistance":
        return units
    low, high = limits_degC
    span = float(np.ptp(film.simulate(np.linspace(low, high, 401), film.initial_memory(low, "heated"))[0]))
    return replace(units, factor=units.factor * LAW_SPAN / span) if span > 0.0 else units


def in_law_units(film: FilmModel, units: LawUnits) -> FilmModel:
    """Return the film with its output in the law's unit."""
    return film if units.quantity == "resistance" else film.scaled(abs(units.factor))


COMPENSATED: tuple[LawName, ...] = ("full", "feedforward", "temperature")


def known_plate(plate: PlateModel, effects: Sequence[Switched]) -> KnownPlate:
    """Return plate and thermometer of a model, by which a run is watched."""
    own = {e.effect.name: e.values() for e in effects}
    lag_s = own.get("sensor_lag", {}).get("tau_s", 0.0)
    return KnownPlate(plate, lag_s, own.get("actuator_delay", {}).get("delay_s", 0.0))


def chain_observer(
    effects: Sequence[Switched], plate: PlateModel, film: FilmModel | None, period_s: float
) -> Observer | None:
    """Return the observer of a model's chain; None if it has no effects."""
    return Observer(ChainModel(plate, film, tuple(effects)), period_s) if effects else None


def plate_observer(effects: Sequence[Switched], plate: PlateModel, period_s: float) -> Observer | None:
    """Return the observer for a temperature of the plate itself: effects up to the thermometer; None if there is
    none."""
    chosen = [e for e in effects if e.effect.before_film]
    return chain_observer(chosen, plate, None, period_s)


def own_target(target: Target, film: FilmModel | None, effects: Sequence[Switched], units: LawUnits) -> Target:
    """Return the target as the film's own output in the law's units, for a target that the meter shall show."""
    if units.factor != 1.0:
        return replace(target, values=units.law(target.values))
    table = own_output_table(links_of(effects), film) if target.quantity == "resistance" else None
    if table is None:
        return target
    return replace(target, values=np.asarray(np.interp(target.values, *table), dtype=np.float64))
