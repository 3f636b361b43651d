"""Turns of the temperature that no row shows: what a film remembers of them is not known.

Where a current changed between the rows, so did the temperature turn round there. The plate is seen again in the next
row, and its path is corrected; a film keeps the highest and lowest temperature of a loop, which no reading tells. How
far off it may be is how far the plate may have gone in between (`unlogged_walk`), on the film's flank.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from sim.diagnosis.data.noise_model import root_mean_square
from sim.diagnosis.fit.seen_path import steepness
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.adequacies import resistance_residual

TURNS: Final = "no more than what the film remembers of turns of the temperature between the rows, which no row shows"
TWICE: Final = 4.0  # times its variance: a loop is passed through more than once with the same error


def only_turns(chain: Chain, names: frozenset[str], unexplained: Mapping[str, str | None]) -> bool:
    """Whether what is left is the film's alone, and no more than what turns between the rows may leave. unexplained: by
    channel, in words, None: nothing."""
    if unexplained["temperature_K"] is not None or unexplained["resistance_dec"] is None:
        return False
    most = _most(chain, names)
    if most == 0.0:
        return False
    z, _ = resistance_residual(chain, names)
    return float(np.mean(z * z)) - 1.0 < most


def _most(chain: Chain, names: frozenset[str]) -> float:
    """Mean square over the noise's; 0 where every current is logged."""
    fit, first = chain.fits(names)[1], chain.first
    if fit is None or first is None or first.channel.noise.wandering is None or chain.facts is None:
        return 0.0
    gone_K = root_mean_square(np.sqrt(first.channel.noise.wandering.added))
    channel = chain.film_channel(names)
    over_noise = steepness(channel, fit)[channel.rows] / chain.facts.noise.marginal(channel.output[channel.rows])
    return TWICE * (gone_K * root_mean_square(over_noise)) ** 2
