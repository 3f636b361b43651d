"""Which effects have a temperature of their own, unknown at the first row and after each long gap."""

from __future__ import annotations

from collections.abc import Sequence

from sim.effects.effect import Filter, HeatFlow, Switched
from sim.model.links import links_of


def has_own(effect: Switched) -> bool:
    """Whether it is a body on the plate's balance with a temperature of its own."""
    return isinstance(effect.effect.form, HeatFlow) and effect.effect.form.own_rate is not None


def _delays_the_thermometer(effect: Switched) -> bool:
    return isinstance(effect.effect.form, Filter) and effect.effect.form.target == "thermometer"


def own_temperatures(effects: Sequence[Switched]) -> int:
    """How many of the effects have one: as many as `with_own_temperature` gives, which a fit asks for too often to have
    its links put in order each time."""
    return sum(has_own(e) or _delays_the_thermometer(e) for e in effects)


def with_own_temperature(effects: Sequence[Switched]) -> list[Switched]:
    """The effects that have one, in the chain's order: on the plate's balance, then filters of the thermometer."""
    links = links_of(effects)
    return [*(e for e in links.plate if has_own(e)), *links.thermometer]
