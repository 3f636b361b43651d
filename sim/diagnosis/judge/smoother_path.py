"""Whether a lag of film or ohmmeter is more than a filter for the noise of the temperature that drives the film.

On a path that was measured, or corrected by what was measured, a lag makes the film's readings likelier for what it
takes off the path's noise, and a skew takes its delay back: a skew of 2 s was named a lag of 1 s and a skew of 1 s, and
a record with nothing hidden a lag of 3.3 s and a skew of -3 s.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from sim.diagnosis.fit.smoother_path import AS_SMOOTH
from sim.diagnosis.search.chain import Chain, Found
from sim.effects.effect import Filter

LEAST_BEYOND: Final = 100.0  # log-likelihood of a lag beyond a smoother path: no kernel is just what the noise asks for


def beyond_a_smoother_path(chain: Chain, names: frozenset[str], name: str) -> float | None:
    """By how much the log-likelihood falls without a lag of the last links, on a path that is smoothed as much besides,
    everything else following. None for another effect, and on a path that is simulated as it is, which has no noise."""
    if name not in chain.split(names)[1] or not _is_lag(chain, name) or not _has_noise(chain, names):
        return None
    b = chain.fits(names)[1]
    assert b is not None
    tau_s = next(e.values()["tau_s"] for e in b.effects if e.name == name)
    other = on_smoothed(chain, names - {name}, AS_SMOOTH * tau_s)
    return chain.score(names) - other.score(names - {name})


def on_smoothed(chain: Chain, names: frozenset[str], smooth_s: float) -> Chain:
    """On a path that is smoothed by so much besides, with these effects, fitted from where they were."""
    other = replace(chain, smooth_s=math.hypot(chain.smooth_s, smooth_s), found=Found(), together=False)
    upstream, downstream = chain.split(names)
    other.last(upstream).fit(downstream, chain.fits(names)[1])
    return other


def _has_noise(chain: Chain, names: frozenset[str]) -> bool:
    """Whether the path that drives the film is not just what was simulated."""
    a, b = chain.fits(names)
    if b is None or chain.joint(names) is not None:
        return False
    return a is None or chain.last(chain.split(names)[0]).channel.path is not a.path


def _is_lag(chain: Chain, name: str) -> bool:
    form = chain.effects[name].form
    return isinstance(form, Filter) and form.target in ("film_temperature", "log_resistance")
