"""Intervals of the effects' parameters: the curvature at the fit, every other unknown free.

The residual of a fit that leaves nothing is white, so that the curvature is enough; where it is not, the covariance
is widened by how far apart the sums over blocks of rows are (block sandwich, `sim.inference.covariance`);
beside a film that switches in steps, over blocks of the loop, too.
"""

from __future__ import annotations

from itertools import islice

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_basis import SHAPE
from sim.diagnosis.fit.temperature_channel import FIRST_STEP_K
from sim.diagnosis.fit.unknowns import fitted_parameters, unknown_of
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.temperature_search import cell_of, cells
from sim.diagnosis.validate.adequacies import temperature_residual
from sim.diagnosis.validate.deviations import deviations, film_deviations, not_told
from sim.effects.effect import Switched, jumps
from sim.inference.covariance import NORMAL_95

HALF_CHI2_95 = 1.92  # the fall of the log-likelihood to either side: half of chi square's 3.84
MUCH_WORSE = 8.0  # log-likelihood
ON_END = 4  # cells much worse that end an interval
MOST_CELLS = 40
MEANINGLESS = 4.0  # half an interval on a log scale from which it has no meaning
FARTHEST = 20.0  # half an interval on the fit's scale that is given: exp of it is no size
VAGUE = 30.0  # ratio of an interval's ends from which nothing is known of the size


def first_deviations(chain: Chain, names: frozenset[str]) -> Array | None:
    """Standard deviations of the first links' unknowns, plate before effects, on the fit's scale, infinite of one that
    the record leaves open beside the others; None without them."""
    joint = chain.joint(names)
    if joint is not None:
        return _with_open_ones(*joint.columns())[: joint.a.parameters.x.size]
    a, _ = chain.fits(names)
    if a is None or chain.first is None:
        return None
    z, rows = temperature_residual(chain, names)
    channel = chain.first.channel
    p = a.parameters
    first = channel.simulate(p, p.x, p.first_degC + FIRST_STEP_K)[1][rows] - a.shown_degC[rows]
    e = channel.over(first) / FIRST_STEP_K
    weight = np.sqrt(a.curvature)
    j = channel.over(a.jacobian[rows])
    d = np.bincount(channel.stretch, weight**2 * e * e, channel.stretches) + 1e-12  # > 0 of one without readings
    for k in range(j.shape[1]):
        part = np.bincount(channel.stretch, weight**2 * e * j[:, k], channel.stretches) / d
        j[:, k] -= e * part[channel.stretch]
    return _with_open_ones(weight[:, None] * j, z)


def _with_open_ones(columns: Array, z: Array) -> Array:
    """Standard deviations, infinite of an unknown that the rows leave open beside the others."""
    return np.where(not_told(columns, z), np.inf, deviations(columns, z))


def intervals(chain: Chain, names: frozenset[str]) -> dict[str, dict[str, tuple[float, tuple[float, float] | None]]]:
    """By effect and parameter: the value and its 95 % interval, None where an interval has no meaning."""
    a, b = chain.fits(names)
    out: dict[str, dict[str, tuple[float, tuple[float, float] | None]]] = {}
    first = first_deviations(chain, names)
    if a is not None and first is not None:
        out |= _by_name(list(a.effects), first[len(a.parameters.base) :])
    joint = chain.joint(names)
    if joint is not None:
        p = joint.a.parameters
        begin = p.x.size + p.first_degC.size + SHAPE
        out |= _by_name(list(joint.b.effects), deviations(*joint.columns())[begin:])
    elif b is not None:
        out |= _by_name(list(b.effects), film_deviations(chain, names)[SHAPE:])
    return out | _profiles(chain, names)


def vague_effects(chain: Chain, names: frozenset[str]) -> list[str]:
    """Effects of the last links of which the record tells next to no size: the film's own shape absorbs them."""
    _, downstream = chain.split(names)
    found = []
    for name, parameters in intervals(chain, names).items():
        for parameter in fitted_parameters(chain.effects[name]):
            ci = parameters[parameter.name][1]
            if name in downstream and (ci is None or ci[0] < 0.0 < ci[1] or 0.0 < VAGUE * ci[0] < ci[1]):
                found.append(name)
    return sorted(set(found))


def _by_name(
    effects: list[Switched], deviations: Array
) -> dict[str, dict[str, tuple[float, tuple[float, float] | None]]]:
    out: dict[str, dict[str, tuple[float, tuple[float, float] | None]]] = {}
    k = 0
    for e in effects:
        values: dict[str, tuple[float, tuple[float, float] | None]] = {}
        for j, p in enumerate(e.effect.parameters):
            value = float(e.par[j])
            if p in fitted_parameters(e.effect):
                u = unknown_of(e.effect, p)
                x, half = u.inside(value), NORMAL_95 * float(deviations[k])
                low, high = u.outside(x - min(half, FARTHEST)), u.outside(x + min(half, FARTHEST))
                values[p.name] = (value, None if u.log and half > MEANINGLESS else (low, high))
                k += 1
            else:
                values[p.name] = (value, None)
        out[e.name] = values
    return out


def _profiles(chain: Chain, names: frozenset[str]) -> dict[str, dict[str, tuple[float, tuple[float, float] | None]]]:
    """The intervals of effects whose cost jumps."""
    a, _ = chain.fits(names)
    out = {}
    for effect in a.effects if a is not None else ():
        if jumps(effect.effect):
            out[effect.name] = {effect.effect.parameters[0].name: _profile(chain, names, effect)}
    return out


def _profile(chain: Chain, names: frozenset[str], effect: Switched) -> tuple[float, tuple[float, float] | None]:
    """The values of a parameter that has to be searched for at which the likelihood falls by less than
    `HALF_CHI2_95`.

    All else follows. The cost is not smooth: a stretch that is worse ends the interval only where it is much worse for
    some cells on end.
    """
    assert chain.first is not None
    search = chain.first
    fit = search.fit(chain.split(names)[0])
    original = search.effects[effect.name]
    edges = cells(original, search.channel.record)
    at = float(effect.par[0])
    middle = cell_of(at, edges)
    ends = []
    for side in (-1, 1):
        last, worse = middle, 0
        # three steps of all else: from cell to cell it hardly moves
        for k, near in islice(search.walk(fit, original, edges, side, 3), MOST_CELLS - 1):
            fall = near.minus_log - fit.minus_log
            if fall < HALF_CHI2_95:
                last = k
            worse = worse + 1 if fall > MUCH_WORSE else 0
            if worse == ON_END:
                break
        ends.append(last)
    low, high, largest = float(edges[ends[0]]), float(edges[ends[1] + 1]), original.parameters[0].largest
    if edges[ends[1]] < largest:  # the record sets no end below: what is met does
        high = min(high, largest)
    return min(at, high), (low, high)
