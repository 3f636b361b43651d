"""The kind of plate, where the drive does not say it: the one that leaves less once effects are there.

A drive that never cools may be a heater's or a Peltier plate's. The plate alone is fitted as both, and the better one
is searched on. But a heat sink that warms up, or a room that drifts, bends the course of the right kind, and the wrong
kind may then be nearer to it: where the better one leaves more than the noise, both are searched for effects.
"""

from __future__ import annotations

import numpy as np

from sim.diagnosis.data.record import Record
from sim.diagnosis.search.budget import SEARCHING, Budget
from sim.diagnosis.search.chain import temperature_search
from sim.diagnosis.search.stepwise import LEAVES_LESS, ROUGH, select_first_links
from sim.diagnosis.search.temperature_search import TemperatureSearch
from sim.effects.effect import Effect


def search_of_either_kind(
    record: Record,
    effects: dict[str, Effect],
    kinds: tuple[str, ...],
    assumed: frozenset[str],
    budget: Budget,
) -> TemperatureSearch:
    """That of the first links (`temperature_search`), with the kind among several that tells the record."""
    first = temperature_search(record, effects, kinds, assumed, budget)
    if not is_open(first, kinds) or budget.over(SEARCHING):
        return first
    others = tuple(kind for kind in kinds if kind != first.base.parameters.kind)
    other = temperature_search(record, effects, others, assumed, budget)
    return other if _left_K(other) < LEAVES_LESS * _left_K(first) else first


def is_open(search: TemperatureSearch, kinds: tuple[str, ...]) -> bool:
    """Whether the plate alone leaves so much that another of these kinds has to be searched for effects, too."""
    misfit = 2.0 * search.base.minus_log > ROUGH * search.channel.rows.size
    return misfit and any(kind != search.base.parameters.kind for kind in kinds)


def _left_K(search: TemperatureSearch) -> float:
    """Root mean square of what is left in the fitted rows, with the effects that they ask for."""
    fit, rows = search.fit(select_first_links(search)), search.channel.rows
    return float(np.sqrt(np.mean((search.channel.record.temperature_degC - fit.shown_degC)[rows] ** 2)))
