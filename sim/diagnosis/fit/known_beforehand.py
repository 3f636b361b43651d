"""What is known of a plate before its record is read: a laboratory's room, bodies near it, typical sizes.

Where a fit leaves nothing, this hardly counts beside thousands of readings. Where it leaves something that no model
explains, it is what keeps a room from -15 degC and a delay from ten seconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Rows
from sim.diagnosis.fit.plate_parameters import ROOM
from sim.diagnosis.fit.unknowns import fitted_sizes, met_inside, unknowns_of
from sim.effects.effect import Switched

AMBIENT_DEGC = (25.0, 15.0)  # of a laboratory, and its spread
AMBIENT_BESIDE_K = 5.0  # the same where a fit leaves what it cannot explain: from 15 to 35 degC within two of them
BODIES_BESIDE = 2.0  # there bodies and filters are half as far apart: a bench that rested before, or nearly so
SIZES_WITHIN = 4.0  # spreads from the smallest to the largest size met: all but one in twenty within


def known_beforehand(
    x: Array, base: int, rooms: int, effects: Sequence[Switched], bodies: int, beside: bool
) -> tuple[Array, Rows, Array]:
    """(how far off, in spreads; which unknown each speaks of; by how many spreads a step of that changes it).

    x: the fit's vector: base unknowns of the plate with the room last, sizes of effects, rooms of further records,
    bodies. beside: whether the fit leaves what it cannot explain.
    """
    spread = AMBIENT_BESIDE_K if beside else AMBIENT_DEGC[1]
    own = bodies + rooms
    index = np.concatenate(([base - 1], np.arange(x.size - own, x.size))).astype(np.int64)
    scale, centre = np.ones(index.size), np.zeros(index.size)
    scale[0], centre[0] = ROOM.scale / spread, ROOM.inside(AMBIENT_DEGC[0])
    if beside:
        scale[index.size - bodies :] = BODIES_BESIDE
        sizes = unknowns_of(effects)
        met = [met_inside(u, q) for u, q in zip(sizes, fitted_sizes(effects), strict=True)]
        index = np.concatenate((index, base + np.arange(len(sizes)))).astype(np.int64)
        centre = np.concatenate((centre, [0.5 * (low + high) for low, high in met]))
        scale = np.concatenate((scale, [SIZES_WITHIN / (high - low) for low, high in met]))
    return scale * (x[index] - centre), index, scale
