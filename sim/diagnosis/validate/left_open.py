"""What the fitted rows leave open of a film: by how much it may show something else in rows that no fit has seen.

A film's coefficients are known as well as the fitted rows tell them. A record that goes where these never were is
predicted no better than that, whatever its noise. The fit's equations are linear in the coefficients, whose
covariance is the inverse of the fit's normal matrix (C. Rasmussen, C. Williams, Gaussian Processes for Machine
Learning, 2006, section 2.1); films drawn from it are run over the rows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.held_out import on_other

DRAWS = 32  # films: a variance over many rows is right to an eighth or so


def film_left_open(chain: Chain, names: frozenset[str], other: Record | None = None) -> Array:
    """Standard deviation of what the fit's film shows in each row of another record of the rig, None: of its own;
    decades, (rows,)."""
    b = chain.fits(names)[1]
    assert b is not None
    point = chain.film_channel(names).point_of(b)
    factor, lower = point.factor
    white = np.random.default_rng(0).standard_normal((factor.shape[0], DRAWS))
    drawn = np.array(solve_triangular(factor, white, lower=lower, trans=1 if lower else 0, check_finite=False).T)
    if other is None:
        plain = point.problem.own.shape[1]
        apart = [point.problem.at_rows @ c[:plain] + point.problem.relays.shown(c[plain:]) for c in drawn]
    else:
        fitted, own, path, _ = on_other(chain, names, other)
        shown = fitted.shown(other, path, own)
        films = (replace(fitted, b=replace(b, coefficients=b.coefficients + c)) for c in drawn)
        apart = [film.shown(other, path, own) - shown for film in films]
    return np.asarray(np.sqrt(np.mean(np.square(apart), axis=0)), dtype=np.float64)
