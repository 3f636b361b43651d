"""How the phases of the film mix, as the record has it: of a film that does not add logarithms.

R^p = (1 - s) R_i^p + s R_m^p with p = exponent + tilt (2 s - 1), s the share that is metal: -1 domains in parallel, 0
logarithms add, 1 domains in series (`sim.model.film_mixing`). Without intervals: of four films that an independent
generator drew, three had exponents 0.2 to 0.3 beside what was found, outside the curvature's interval. R_i changes
with temperature; here the step does so in proportion, and the three numbers make up for each other.
"""

from __future__ import annotations

from typing import Final

from sim.diagnosis.fit.film_basis import ENVELOPES
from sim.diagnosis.search.chain import Chain

NAMES: Final = ("step_change_per_K", "exponent", "exponent_tilt")  # in the order of the fit's unknowns


def phase_mixing(chain: Chain, names: frozenset[str]) -> dict[str, float]:
    """By name. step_change_per_K: by what share of itself the step of log R between the phases changes with
    temperature. Empty for a film that mixes in its logarithms, or where there is none."""
    fit = chain.fits(names)[1]
    if fit is None or not fit.parameters.is_mixed:
        return {}
    change, exponent, tilt = fit.parameters.x[ENVELOPES : ENVELOPES + len(NAMES)].tolist()
    farthest_K = chain.film_channel(names).basis.mixing.farthest_K
    return dict(zip(NAMES, (change / farthest_K, exponent, tilt), strict=True))
