"""How well a record tells the unknowns of a fit: standard deviations that hold for rows that hang together."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask, Rows
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.search.chain import Chain
from sim.inference.covariance import block_sandwich


def deviations(columns: Array, z: Array) -> Array:
    """Standard deviations of unknowns whose columns were freed of all others; 0 of one that is held."""
    moves = np.any(columns != 0.0, axis=0)
    if not np.all(moves):
        out = np.zeros(moves.size)
        out[moves] = deviations(columns[:, moves], z)
        return out
    plain = of_independent_rows(columns)
    wide = np.asarray(block_sandwich(columns, z).standard_errors)
    return np.asarray(np.maximum(plain, np.where(np.isfinite(wide), wide, 0.0)), dtype=np.float64)


def not_told(columns: Array, z: Array) -> Mask:
    """Which unknowns, (unknowns,), have a share in a combination that the rows do not tell: of such a one
    `deviations` says how far it moves while that combination stays, as if somebody knew it."""
    return np.isinf(block_sandwich(columns, z).standard_errors)


def of_independent_rows(columns: Array) -> Array:
    """The same of rows that do not hang together."""
    normal = columns.T @ columns
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))  # > 0
    # by the pseudoinverse: two unknowns may do the same
    covariance = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)), dtype=np.float64)


def film_deviations(chain: Chain, names: frozenset[str]) -> Array:
    """Of the film's unknowns, shape before effects, on the fit's scale. What domains do at one temperature comes again
    in each pass, so that rows of many passes are worth those of one."""
    return _of_film(chain, *_film_columns(chain, names))


def _of_film(chain: Chain, columns: Array, z: Array, last: ResistanceChannel, b: ResistanceFit) -> Array:
    found = deviations(columns, z)
    if chain.facts is not None and chain.facts.domains is not None:
        order = _along_the_loop(last, b)
        found = np.maximum(found, deviations(columns[order], z[order]))
    return found


def of_one_pass(chain: Chain, names: frozenset[str]) -> Array:
    """By how much less than the likelihood says the record tells of each of the film's unknowns: the share of evidence
    that is left where rows that come again are no further evidence."""
    columns, z, last, b = _film_columns(chain, names)
    plain, found = of_independent_rows(columns), _of_film(chain, columns, z, last, b)
    return np.minimum((plain / np.maximum(found, 1e-300)) ** 2, 1.0)


def _film_columns(chain: Chain, names: frozenset[str]) -> tuple[Array, Array, ResistanceChannel, ResistanceFit]:
    """Columns of the unknowns in the fitted rows, freed of the film's coefficients; the residual; over the noise."""
    b = chain.fits(names)[1]
    assert b is not None
    last = chain.film_channel(names)
    point = last.point_of(b)
    return point.off(last.over(b.jacobian[last.rows])), last.residual(b), last, b


def _along_the_loop(channel: ResistanceChannel, fit: ResistanceFit) -> Rows:
    """The fitted rows in order of direction and temperature."""
    film_degC = channel.film_degC(fit)
    rising = np.gradient(film_degC) > 0.0
    return np.lexsort((film_degC[channel.rows], rising[channel.rows]))
