"""Whether the size that a fit has found is one that an effect can have."""

from __future__ import annotations

import numpy as np

from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.fit.temperature_channel import TemperatureFit
from sim.diagnosis.search.resistance_search import ResistanceSearch
from sim.diagnosis.search.temperature_search import TemperatureSearch
from sim.effects.effect import Switched

SMALL = 0.2  # of the smallest size met
LEAST_TIME = LEAST_BESIDE = 0.5  # the same of a time, and where the film is of another kind
SHORT = 0.2  # of the sampling interval: shorter delays are one class
BEYOND = 2.0  # times the largest size met: more has no physical meaning
INSIDE = (
    0.99  # the same beside what nothing explains, where a fit goes no further: at that end it stands in for a cause
)
ELSEWHERE = 3.0  # times beyond what is met, from which a parameter beside the size makes it another effect


def without_meaning(effect: Switched, interval_s: float, beyond: float = np.inf, least: float = SMALL) -> bool:
    """Whether an effect's size has no physical meaning: below `least` of the smallest met (a time: below half, or below
    a fifth of the sampling interval); or `beyond` times the largest met. Or what it has besides: a creep of some
    seconds is a lag."""
    parameters = effect.effect.parameters
    first = next((k for k, p in enumerate(parameters) if not p.choices), None)
    if first is None:
        return False
    p, value = parameters[first], abs(float(effect.par[first]))
    for q, other in zip(parameters[first + 1 :], effect.par[first + 1 :], strict=True):
        if not q.choices and not q.smallest / ELSEWHERE <= abs(float(other)) <= q.largest * ELSEWHERE:
            return True
    if effect.effect.inverse:
        return value > p.largest / least or value < p.smallest / beyond**2
    if value > beyond * p.largest:
        return True
    is_time = p.name.endswith("_s") and "per" not in p.name
    return value < max(LEAST_TIME * p.smallest, SHORT * interval_s) if is_time else value < least * p.smallest


def most_of_what_is_met(misfit: float) -> float:
    """Times the largest size met, up to which an effect in a search of the first links may be followed up."""
    return INSIDE if misfit > 1.0 else np.inf


def has_meaning(search: TemperatureSearch | ResistanceSearch, fit: TemperatureFit | ResistanceFit) -> bool:
    """Whether every size that was found has a meaning; those assumed are the user's."""
    interval = search.channel.record.interval_s
    beyond = most_of_what_is_met(search.channel.misfit) if isinstance(search, TemperatureSearch) else np.inf
    found = [Switched(search.effects[e.name], e.par) for e in fit.effects if e.name not in search.assumed]
    return not any(without_meaning(e, interval, beyond) for e in found)
