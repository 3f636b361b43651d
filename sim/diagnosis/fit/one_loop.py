"""What one loop alone says of a film: whether its branches are each other's mirror image, or shifted copies.

Play operators with one pair of envelopes rise on heating with the weights that they have passed, and fall on cooling
with those that they have passed from the other end: where both envelopes are about alike, the branches are mirror
images. A film of grains that switch each for itself, all with about the same hysteresis, has branches that are shifted
copies: steep towards the metal on both, if grains conduct in parallel. Minor loops tell the two apart. One loop does
not, where a flank has a row each 0.4 decades: each kind fits the rows it is fitted to, and between them the mirror
image of the other flank is off by a third of a decade. So the rows that decide are asked, and the play operators are
left as much as relays do not need.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.diagnosis.fit.channel_noise import ohmmeter_noise
from sim.diagnosis.fit.film_prior import PriorWidths
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit

PLAYS_SHARE = 0.1  # of the output's range, that all play operators of a film of relays come to
STEPS = 12
ROUNDS = 2  # of the noise, which the better film shows
BETTER = 8.0  # log-likelihood of the rows that decide


def shifted_branches(channel: ResistanceChannel, p: FilmParameters, least_dec: float) -> ResistanceFit | None:
    """The fit of a film of relays, weighed by the noise that it shows; None where the rows that decide do not ask for
    it. p: of the Prandtl-Ishlinskii film; least_dec: the noise at least."""
    record = channel.record
    rows = np.flatnonzero(record.deciding & record.output_used)
    if not rows.size:
        return None
    own = channel.descend(p.with_relays(PriorWidths().first_relay_dec), STEPS)
    prior = PriorWidths.of_relays(PLAYS_SHARE * float(np.ptp(channel.output[channel.rows])), channel.basis)
    other = channel.descend(replace(p, prior=prior), STEPS)
    for _ in range(ROUNDS):
        noise = ohmmeter_noise(channel, other, least_dec, 0.0)
        channel = ResistanceChannel.of(record, channel.path, channel.fitted, noise, channel.basis)
        other = channel.descend(replace(p, prior=prior), STEPS)
    sigma = channel.noise.marginal(channel.output[rows], rows)
    worse, better = (float(np.sum(((channel.output - f.shown)[rows] / sigma) ** 2)) for f in (own, other))
    return other if 0.5 * (worse - better) > BETTER else None
