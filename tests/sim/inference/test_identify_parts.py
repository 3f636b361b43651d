"""The parts of an identification: derivatives, least squares, covariance, against second opinions."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from compensator.hysteresis.film import Envelope
from sim.inference.covariance import block_sandwich
from sim.inference.film.fit import merged
from sim.inference.film.memoryless_forms import FORMS, Form
from sim.inference.joint.films import ENVELOPES
from sim.inference.levenberg_marquardt import Linearized, descend
from sim.inference.nnls import reduced, solve_triangle
from sim.model.operator_outputs import radius_floor
from tests.compensator.film_models import plain_envelope


@pytest.mark.parametrize("function", ENVELOPES)
def test_the_smallest_radius_is_what_the_order_condition_needs(function: str) -> None:
    rng = np.random.default_rng(0)
    v = np.linspace(-300.0, 400.0, 700001)
    for _ in range(20):
        a, c = np.exp(rng.uniform(-3, 0, 2)), rng.uniform(50, 70, 2)
        rising, falling = (Envelope(function, float(a[k]), float(-a[k] * c[k])) for k in range(2))
        gap = plain_envelope(rising, v) - plain_envelope(falling, v)
        floor = radius_floor(np.array([np.log(a[0]), c[0], np.log(a[1]), c[1]]), rising.row()[0])
        assert max(0.5 * gap.max(), 0.0) <= floor + 1e-9
        assert floor == pytest.approx(max(0.5 * gap.max(), 0.0), abs=1e-6)


def test_reduced_nonnegative_least_squares() -> None:
    rng = np.random.default_rng(1)
    m, y = np.cumsum(rng.normal(size=(300, 12)), axis=0), rng.normal(size=300)
    columns = np.column_stack((m, y))
    r = reduced(columns.T @ columns)
    x, square = solve_triangle(r, 2)
    signed = np.column_stack((m, -m[:, :2]))
    reference, norm = scipy.optimize.nnls(signed, y)
    reference[:2] -= reference[12:]
    assert np.allclose(x, reference[:12], atol=1e-6)
    assert square == pytest.approx(norm**2, rel=1e-9)
    doubled = np.column_stack((m, m[:, 3], y))
    assert solve_triangle(reduced(doubled.T @ doubled), 0)[1] <= scipy.optimize.nnls(m, y)[1] ** 2 * (1 + 1e-6)


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("monotone", [True, False])
def test_a_form_is_the_model_s_own_function(name: str, monotone: bool) -> None:
    from compensator.hysteresis.functions import memoryless

    form = Form(name, monotone, 20.0, 95.0)
    low, high = form.bounds()
    v = np.linspace(20.0, 95.0, 400)
    for share in (0.2, 0.7):
        par = low + share * (high - low)
        columns = form.columns(v, par)
        coefficients = np.linspace(0.5, 1.3, columns.shape[1])
        d = form.memoryless(coefficients, par, -3.0)
        array = d.array()
        values = [memoryless(d.code, array, x)[0] for x in v]
        assert np.allclose(values, columns @ coefficients - 3.0, atol=1e-9)
        if monotone and columns.shape[1]:
            assert np.min(np.diff(columns, axis=0)) > -1e-12


def test_the_sandwich_covers_where_white_noise_formulas_do_not() -> None:
    rng = np.random.default_rng(2)
    n, inside, white = 1200, 0, 0
    x = np.column_stack((np.ones(n), np.sin(np.arange(n) / 90.0)))
    for _ in range(120):
        noise = np.convolve(rng.normal(size=n + 39), np.ones(40) / 6.3, "valid")
        fit, *_ = np.linalg.lstsq(x, noise, rcond=None)
        residual = noise - x @ fit
        error = block_sandwich(x, residual).standard_errors
        plain = np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * np.mean(residual**2))
        inside += int(abs(fit[1]) < 1.96 * error[1])
        white += int(abs(fit[1]) < 1.96 * plain[1])
    assert inside > 0.85 * 120
    assert white < 0.6 * 120


def test_what_rows_do_not_determine_has_no_standard_error() -> None:
    rng = np.random.default_rng(3)
    a = rng.normal(size=200)
    x = np.column_stack((a, 2.0 * a, rng.normal(size=200)))
    errors = block_sandwich(x, rng.normal(size=200)).standard_errors
    assert np.isinf(errors[:2]).all()
    assert np.isfinite(errors[2])


def test_merging_keeps_the_weights_and_their_mean() -> None:
    weights = np.zeros(40)
    weights[[3, 4, 20, 33]] = [0.2, 0.6, 0.5, 0.1]
    few = merged(np.arange(40) / 40, weights, 3)
    assert few.tolist() == pytest.approx([(0.2 * 3 + 0.6 * 4) / 0.8 / 40, 0.5, 33 / 40])


def test_a_descent_from_a_trial_without_an_end_stays_there() -> None:
    """As of an own effect that is no number: its damping grew until numpy warned of it."""

    def linearized(at: float) -> Linearized[float]:
        nothing = np.full((2, 2), np.nan)
        return Linearized(nothing, nothing[0], nothing[0], lambda step: at)

    assert descend(1.0, 100, lambda at: np.inf, linearized, lambda before, after: False) == 1.0
