"""What rows that no fit has seen say of effects: of the likelihood, and how much is left there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.fit_steps import RELAY_STEPS
from sim.diagnosis.validate.deciding_rows import deciding_rows, over_noise

Prediction = tuple[frozenset[str], Array, ResistanceFit | None]  # effects, held-out residual, fit where another one


@dataclass(frozen=True)
class HeldOutEvidence:
    """gain: of the log-likelihood of rows that no fit has seen; changed: what the effects change there, sum of squares
    over the noise's."""

    gain: float
    changed: float


def held_out_evidence(chain: Chain, names: frozenset[str], rest: frozenset[str]) -> HeldOutEvidence | None:
    """What unseen rows say of the effects that `rest` lacks; None without such rows. Relays tell them better than play
    operators alone wherever a film is not quite of its class: where the fit without the effects has relays, so has the
    one with them here."""
    found = []
    for last in (False, True):
        if (a := held_out_residual(chain, rest, last)) is None:
            continue
        other = _with_relays_of(chain, names, rest) if last else None
        if (b := held_out_residual(chain, names, last, other)) is None:
            continue
        if last and chain.facts is not None and chain.facts.domains is not None:
            found.append(_beside_domains(chain, (rest, a, None), (names, b, other)))
        else:
            a, b = over_noise(chain, a, last), over_noise(chain, b, last)
            found.append(HeldOutEvidence(0.5 * float(a @ a - b @ b), float((a - b) @ (a - b))))
    return HeldOutEvidence(sum(f.gain for f in found), sum(f.changed for f in found)) if found else None


def _beside_domains(chain: Chain, without: Prediction, whole: Prediction) -> HeldOutEvidence:
    """Of the film's rows, by the likelihood of a prediction: how well the fitted rows tell the coefficients of a film
    that switches in steps is what held-out rows are off by, block by block, beside noise and steps."""
    lower_a, lower_b = (_predictive_root(chain, names, other) for names, _, other in (without, whole))
    rest, left = (over_noise(chain, residual, True) for _, residual, _ in (without, whole))
    a, b = solve_triangular(lower_a, rest, lower=True), solve_triangular(lower_b, left, lower=True)
    log_det = float(np.sum(np.log(np.diag(lower_a))) - np.sum(np.log(np.diag(lower_b))))
    changed = solve_triangular(lower_b, rest - left, lower=True)
    return HeldOutEvidence(0.5 * float(a @ a - b @ b) + log_det, float(changed @ changed))


def _predictive_root(chain: Chain, names: frozenset[str], other: ResistanceFit | None) -> Array:
    """The Cholesky factor of the held-out residuals' covariance over the noise: that of the noise, and of the fitted
    coefficients (C. Rasmussen, C. Williams, Gaussian Processes for Machine Learning, 2006, equation 2.9)."""
    b = other if other is not None else chain.fits(names)[1]
    assert b is not None
    point = chain.film_channel(names).point_of(b)
    rows, relays = deciding_rows(chain, True), point.problem.relays
    shown = relays.every[rows] if relays.slope is None else relays.every[rows] * relays.slope[rows, None]
    columns = over_noise(chain, np.concatenate((point.problem.at_rows[rows], shown), axis=1), True)
    covariance = columns @ cho_solve(point.factor, columns.T, check_finite=False)
    return np.asarray(np.linalg.cholesky(np.eye(rows.size) + covariance), dtype=np.float64)


def _with_relays_of(chain: Chain, names: frozenset[str], rest: frozenset[str]) -> ResistanceFit | None:
    """The last channel's fit with as wide a prior of relays as the one without the effects has."""
    fit, without = chain.fits(names)[1], chain.fits(rest)[1]
    if fit is None or without is None or fit.parameters.has_relays or not without.parameters.has_relays:
        return fit
    wide = fit.parameters.with_relays(without.parameters.prior.relay_dec)
    return chain.film_channel(names).descend(wide, RELAY_STEPS, settle=False)


def held_out_residual(
    chain: Chain, names: frozenset[str], last: bool, other: ResistanceFit | None = None
) -> Array | None:
    """One channel's residual in the rows that no fit has seen, K or decades; None without such rows. other: fit of the
    last channel than the one with these effects."""
    record, (a, b) = chain.record, chain.fits(names)
    b = other if other is not None else b
    residual, rows = np.empty(0), deciding_rows(chain, last)
    if last and b is not None and record.output is not None:
        residual = record.output[rows] - b.shown[rows]
    elif not last and a is not None:
        residual = record.temperature_degC[rows] - a.shown_degC[rows]
    return residual if residual.size else None


def held_out_square(chain: Chain, names: frozenset[str], last: bool) -> float | None:
    """Mean square of one channel's residual over its noise in the rows that no fit has seen; None without such rows."""
    residual = held_out_residual(chain, names, last)
    if residual is None:
        return None
    rows = deciding_rows(chain, last)
    if last and chain.facts is not None and chain.facts.domains is not None:
        z = solve_triangular(_predictive_root(chain, names, None), over_noise(chain, residual, True), lower=True)
        return float(np.mean(z * z))
    if last:
        assert chain.facts is not None
        assert chain.record.output is not None
        sigma = chain.facts.noise.marginal(chain.record.output[rows], rows)
    else:
        assert chain.first is not None
        noise = np.hypot(chain.first.channel.sigma_K, chain.first.channel.step_K / np.sqrt(12.0))
        walk = chain.first.channel.noise.wandering  # a simulation does not know where the plate wandered
        sigma = np.hypot(noise * np.sqrt(chain.first.channel.misfit), 0.0 if walk is None else walk.deviation[rows])
    return float(np.mean((residual / sigma) ** 2))
