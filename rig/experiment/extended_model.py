"""What a model's [[effects]] come to in a run: the law's observer, the target as the film's own, the plate to watch.

A law with effects is the same law with the chain's observer (`compensator.control.observer`, `sim.model.observer`).
Laws without a model ("pid") and without a current ("instrument_pid") gain nothing from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compensator.control.law_step import LawName
from compensator.hysteresis.film import FilmModel
from compensator.thermal.plate import PlateModel
from rig.config.target import Target
from rig.control.law_units import LawUnits
from rig.safety.plate_watch import KnownPlate
from sim.effects.effect import Switched
from sim.model.chain import ChainModel
from sim.model.links import links_of
from sim.model.observer import Observer, own_output_table

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
