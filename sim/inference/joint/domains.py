"""Discrepancy of a film that consists of few domains, as a Gaussian process over the film's memory.

    y = int rho(a, b) s_ab da db + d,      <d(k) d(l)> = step int rho(a, b) s_ab(k) s_ab(l) da db,     s_ab = -1/2, 1/2

A domain switches as a whole, up at temperature a and down at b. Domains of mean size `step` at random places of density
rho / step are shot noise on the plane of (a, b), in addition to the smooth Preisach density rho. d is the integral of
that noise over the domains that are up. It repeats at each pass over the same domains. So, unlike with a process in
time, a second pass is no new evidence for d, and a residual that does not repeat still is evidence for an effect.

The integral is a sum over cells of the plane: cells fine in a and coarse in b, plus cells coarse in a and fine in b,
minus cells coarse in both (a sparse grid; H.-J. Bungartz, M. Griebel, Acta Numerica 13 (2004) 147), since a pass of the
film sweeps long narrow strips. Structure smaller than a fine cell counts as variance of a reading (E. Snelson,
Z. Ghahramani, NIPS 18 (2006) 1257).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.inference.noise import Repeated
from sim.model.film_columns import film_path
from sim.model.film_nodes import FilmNodes
from sim.model.operator_outputs import Integers

LEFT_OUT: Final = 0.3  # of what the sum over cells leaves out: as much again is left out for fewer columns
ROWS_EACH: Final = 4  # rows for each column, that tell along which of their sums most goes on


@dataclass(frozen=True, eq=False)
class Relays:
    """Relays of a Preisach film: switching temperatures, and weight > 0, the step of the output; (relays,) each."""

    up_degC: Array
    down_degC: Array
    weight: Array


@dataclass(frozen=True, eq=False)
class Domains(Repeated):
    """The discrepancy of a film in domains, at the readings of a fit.

    relays: the Preisach density; parts: number of fine and of coarse cells, as in `domain_columns`.
    """

    relays: Relays
    parts: tuple[int, int]


def domain_columns(relays: Relays, nodes: FilmNodes, parts: tuple[int, int]) -> tuple[Array, Array, float]:
    """Return the columns of d, the variance that they neglect for a step of 1, and the mean time per fine cell, s.

    Shapes: (points, columns) and (points,). parts: number of cells in the fine and in the coarse direction.
    """
    weight = relays.weight
    inputs, _ = film_path(nodes)
    slope = np.sign(np.diff(inputs))
    moved = np.flatnonzero(slope)
    turns, after = inputs[moved[1:]], slope[moved[1:]]
    turned = after != slope[moved[:-1]]
    up, wide_up = _parts(relays.up_degC, weight, turns[turned & (after < 0.0)], parts)
    down, wide_down = _parts(relays.down_degC, weight, turns[turned & (after > 0.0)], parts)
    pairs = (_numbered(up, wide_down), _numbered(down, wide_up), _numbered(wide_down, wide_up))
    sums: list[Array] = [np.bincount(part, weights=weight).astype(np.float64) for part in pairs]
    states = [_states(relays, part, total, nodes) / np.sqrt(total) for part, total in zip(pairs, sums, strict=True)]
    within = np.zeros(sums[1].size, dtype=np.int64)
    within[pairs[1]] = pairs[2]
    common = states[2][:, within] * np.sqrt(sums[1] / sums[2][within])
    columns = np.concatenate((states[0], states[1] - common), axis=1)
    first, second, both = (np.sum(state**2, axis=1) for state in states)
    switched = float(np.sum(np.abs(np.diff(states[2] @ np.sqrt(sums[2])))))
    a_part_s = float(np.ptp(nodes.time_s)) * float(np.sum(weight)) / parts[0] / max(switched, 1e-300)
    rest = np.maximum(0.25 * float(np.sum(weight)) - first - second + both, 0.0)
    return *_fewer(columns, rest), a_part_s


def _fewer(columns: Array, rest: Array) -> tuple[Array, Array]:
    """(Fewer columns of nearly the same covariance; what they leave out as well as the rest)."""
    every = 1 + columns.shape[0] // (ROWS_EACH * columns.shape[1])
    some = columns[::every]
    sizes, ways = np.linalg.eigh(every * (some.T @ some))  # sizes rise
    kept = np.cumsum(sizes) > LEFT_OUT * float(np.sum(rest))
    fewer = columns @ ways[:, kept]
    return fewer, rest + np.maximum(np.sum(columns**2, axis=1) - np.sum(fewer**2, axis=1), 0.0)


def _parts(degC: Array, weight: Array, turns_degC: Array, parts: tuple[int, int]) -> tuple[Integers, Integers]:
    """Return the number of the (fine, coarse) cell and of the coarse cell of each relay along one temperature.

    Cells have about equal weights; coarse ones end at turning points of the film, so that a pass sweeps whole cells.
    """
    order = np.argsort(degC, kind="stable")
    below = np.cumsum(weight[order]) / float(np.sum(weight))
    share = np.empty(degC.size)
    share[order] = below
    turns = np.unique(np.interp(turns_degC, degC[order], below, left=0.0, right=1.0))
    turns = turns[(turns > 0.5 / parts[0]) & (turns < 1.0 - 0.5 / parts[0])]
    even = np.arange(1, parts[1]) / parts[1]
    edges = np.unique(turns[np.argmin(np.abs(turns - even[:, None]), axis=1)]) if turns.size else even
    coarse = np.searchsorted(edges, share).astype(np.int64)
    fine = np.minimum((share * parts[0]).astype(np.int64), parts[0] - 1)
    return _numbered(fine, coarse), coarse


def _numbered(first: Integers, second: Integers) -> Integers:
    """Return the number of each pair, counting the distinct pairs from 0."""
    pair = first * (int(np.max(second)) + 1) + second
    return np.asarray(np.unique(pair, return_inverse=True)[1], dtype=np.int64)


def _states(relays: Relays, part: Integers, total: Array, nodes: FilmNodes) -> Array:
    """Return the sum of weight s_ab in each cell at the points, (points, cells). total: sum of weights in each."""
    inputs, side = film_path(nodes)
    rows = nodes.points + (inputs.size - nodes.time_s.size)
    out = np.empty((rows.size, total.size))
    up, down = np.argsort(relays.up_degC), np.argsort(relays.down_degC)
    of_relays = relays.up_degC, relays.down_degC, relays.weight, part
    _switch(inputs, bool(side[0] == -2), rows, up, down, *of_relays, out)
    return out - 0.5 * total


@njit
def _switch(
    inputs: Array,
    cooled: bool,
    rows: Integers,
    by_up: Integers,
    by_down: Integers,
    up_degC: Array,
    down_degC: Array,
    weight: Array,
    part: Integers,
    out: Array,
) -> None:
    """Write the weight of the relays that are up, by cell, at rows of a path into out (rows, cells).

    cooled: True if the path comes from above all relays, else from below. by_up, by_down: order of the relays by their
    switching temperatures.
    """
    on: NDArray[np.bool_] = up_degC <= inputs[0]
    if cooled:
        on = down_degC < inputs[0]
    now = np.zeros(out.shape[1])
    for i in range(on.size):
        if on[i]:
            now[part[i]] += weight[i]
    ups, downs = up_degC[by_up], down_degC[by_down]
    r = 0
    for k in range(inputs.size):
        if k > 0 and inputs[k] > inputs[k - 1]:
            for i in by_up[np.searchsorted(ups, inputs[k - 1]) : np.searchsorted(ups, inputs[k])]:
                if not on[i]:
                    on[i] = True
                    now[part[i]] += weight[i]
        elif k > 0:
            for i in by_down[np.searchsorted(downs, inputs[k]) : np.searchsorted(downs, inputs[k - 1])]:
                if on[i]:
                    on[i] = False
                    now[part[i]] -= weight[i]
        while r < rows.size and rows[r] == k:
            out[r] = now
            r += 1
