"""Intervals of the effects' parameters, from the information matrix of the whitened likelihood.

Whitened residuals of a right model are white; where they are not quite, the sandwich over blocks of rows widens the
intervals (`sim.inference.covariance`). Parameters of plate and film are projected off, the film's weights too.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from compensator.hysteresis.functions import Array
from sim.inference.covariance import NORMAL_95, Covariance, block_sandwich
from sim.inference.joint import Fit

Interval = tuple[float, float]
WIDEST: Final = 20.0  # standard deviations in a logarithm are cut here: exp() of more is no number to report


def covariance(fit: Fit) -> Covariance:
    """Covariance of all of the fit's nonlinear parameters."""
    joint, at = fit.joint, fit.at
    jacobian, residual = joint.jacobian(at, fit.metric), joint.residual(at)
    split = joint.rows_K.size
    if joint.film is not None:
        active = at.design[:, at.active]
        normal = active.T @ active + np.diag(joint.film.precision[at.active])
        scale = 1.0 / np.sqrt(np.diag(normal))
        normal = normal * np.outer(scale, scale) + 1e-9 * np.eye(scale.size)
        film = jacobian[split:]
        film = film - (active * scale) @ cho_solve(cho_factor(normal), (active * scale).T @ film)
        jacobian = np.vstack((jacobian[:split], film))
    known = np.isfinite(joint.prior_deviation)
    precision = np.diag(np.where(known, joint.prior_deviation, np.inf) ** -2.0)
    return block_sandwich(jacobian, residual, precision=precision)


def intervals(fit: Fit) -> dict[str, dict[str, tuple[float, Interval | None]]]:
    """Each effect's parameters with their 95 % intervals; None where an interval has no meaning."""
    if not fit.effects:
        return {}
    errors: Array = covariance(fit).standard_errors
    found: dict[str, dict[str, tuple[float, Interval | None]]] = {}
    for effect in fit.effects:
        values = fit.values()[effect.name]
        own: dict[str, tuple[float, Interval | None]] = {}
        for p in effect.parameters:
            at = fit.joint.place.get(f"{effect.name}.{p.name}")
            if at is None:
                own[p.name] = values[p.name], None
                continue
            reach = NORMAL_95 * min(float(errors[at]), 1e6)
            x = float(fit.at.x[at])
            if p.signed:
                own[p.name] = x, (x - reach, x + reach)
            else:
                reach = min(reach, WIDEST)
                own[p.name] = math.exp(x), (math.exp(x - reach), math.exp(x + reach))
        found[effect.name] = own
    return found


def is_vague(interval: Interval | None, value: float) -> bool:
    """Return True if an interval says nothing of a size: it is wider than the size itself on either side."""
    return interval is not None and interval[1] - interval[0] > 2.0 * abs(value)
