"""Upper limits: of every effect that is not named, the largest size that the record still allows (95 %).

Along one effect the log-likelihood falls by fall(u) = (k u)^2 / 2 - b u, where k u is what a strength u changes in the
whitened readings once plate, film and effects of the fit may follow, and b its slope along the residual. The strength
that fits best is b / k^2 (0 if b < 0), and the likelihood has fallen from there by 1.645^2 / 2 at

    u95 = (max(b, 0) + 1.645 k) / k^2,

the one-sided limit of the profile likelihood (G. Cowan, K. Cranmer, E. Gross, O. Vitells, Eur. Phys. J. C 71 (2011)
1554, section 3.7), never below that of a record that is indifferent (power constraint, arXiv:1105.3166). k and b are
those of the score test, so that a limit costs no fit of its own.
"""

from __future__ import annotations

import math
from typing import Final

from sim.diagnosis.result import UpperLimit
from sim.findings.candidates import Start, possible, scores
from sim.findings.search import Search
from sim.inference.joint import Fit

NORMAL_95_ONE_SIDED: Final = 1.645  # standard deviations on one side hold 95 % of a normal distribution


def upper_limits(fit: Fit, search: Search) -> list[UpperLimit]:
    """Return the limit of every effect that the record could show and the fit does not have."""
    have = {e.name for e in fit.effects}
    effects = [e for e in possible(search.effects, fit.joint) if e.name not in have]
    found = scores(fit, effects, fit.metric, fit.at)
    limits = []
    for effect in effects:
        place = next(k for k, p in enumerate(effect.parameters) if not p.choices)
        size, from_below = effect.parameters[place], effect.inverse and place == 0
        own = [start for start in found if start.effect.name == effect.name]
        # the secant whose limit is nearest to the size at which it was taken
        best = min(own, key=lambda start: abs(math.log(_times(start))), default=None)
        limit = None
        if best is not None:
            times = 1.0 / _times(best) if from_below else _times(best)
            limit = abs(best.values[place]) * times
        limits.append(UpperLimit(effect.name, size.name, limit, from_below, (size.smallest, size.largest)))
    return limits


def _times(start: Start) -> float:
    """Return the limit as a multiple of the strength at which the score was taken."""
    return max(start.amplitude, 0.0) + NORMAL_95_ONE_SIDED / start.change
