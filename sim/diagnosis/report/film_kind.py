"""What kind of film it is: of the class or not, how its phases mix, in which steps it switches.

The phases of a film that does not add logarithms mix by a power mean, or as a medium that percolates
(`sim.model.film_mixing`). Without intervals: of four films that an independent generator drew, three had exponents 0.2
to 0.3 beside what was found, outside the curvature's interval. The three numbers make up for each other, and D(T) for
them.
"""

from __future__ import annotations

from typing import Any, Final

from sim.diagnosis.data.noise_model import root_mean_square
from sim.diagnosis.fit.film_basis import ENVELOPES
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.stepwise import ABSORBS

NAMES: Final = ("step_change_per_K", "exponent", "percolation")  # in the order of the fit's unknowns


def film_kind(chain: Chain, names: frozenset[str]) -> dict[str, Any] | None:
    """As in the JSON; None without a film. domains: of a film that switches visibly, the step of one, and its own RMS
    deviation from a smooth film, which is no noise of the ohmmeter's."""
    facts, output = chain.facts, chain.record.output
    if facts is None or output is None:
        return None
    film: dict[str, Any] = {
        "memoryless": "none" if facts.basis.curve is None else "smooth",
        "operators": int(facts.basis.fractions.size),
        "of_the_class": bool(chain.preisach_evidence(names) < ABSORBS),
    }
    if mixing := _phase_mixing(chain, names):
        film["mixing"] = {name: {"value": value, "ci95": None} for name, value in mixing.items()}
    if facts.domains is not None and facts.noise.wandering is not None:
        own, quantity = root_mean_square(facts.noise.wandering.deviation), chain.record.quantity
        values = {"step": facts.domains.step_dec, "own": own}
        film["domains"] = {f"{name}_{quantity.unit}": value * quantity.size for name, value in values.items()}
    return film


def _phase_mixing(chain: Chain, names: frozenset[str]) -> dict[str, float]:
    """By name. step_change_per_K: by what share of itself the step of log R between the phases changes with
    temperature. Empty for a film that mixes in its logarithms, or where there is none."""
    fit = chain.fits(names)[1]
    if fit is None or not fit.parameters.is_mixed:
        return {}
    change, exponent, percolation = fit.parameters.x[ENVELOPES : ENVELOPES + len(NAMES)].tolist()
    farthest_K = chain.film_channel(names).basis.mixing.farthest_K
    return dict(zip(NAMES, (change / farthest_K, exponent, percolation), strict=True))
