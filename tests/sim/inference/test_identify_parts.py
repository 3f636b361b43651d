"""The parts of an identification: derivatives, least squares, covariance, against second opinions."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from sim.inference.covariance import block_sandwich
from sim.inference.film.memoryless_forms import FORMS, Form
from sim.inference.film.relay_plane import fit_plane, fit_plane_judged, relays_over
from sim.inference.film.rows import FilmRecord, Path, build_path, prepare
from sim.inference.film.selection import make_problem
from sim.inference.film.variable_projection import PlainFit, denser, equal_structure, merged
from sim.inference.levenberg_marquardt import Damping, Linearized, damped_step, descend
from sim.inference.nnls import solve_triangle, triangle
from sim.model.operator_outputs import (
    radius_floor,
)
from sim.model.record_own import FilmStart
from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii, random_profile, relay_film


def prepared(samples: int = 900):
    v = decaying_profile(samples)
    film = is_prandtl_ishlinskii(0)
    y = film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0]
    return prepare(FilmRecord(np.arange(float(samples)), v, y))


def test_derivatives_by_the_outer_parameters() -> None:
    path = build_path([prepared()], [FilmStart("cooled")])
    form = Form("tanh", True, 30.0, 90.0)
    problem = make_problem(path, equal_structure(12, 2), form)
    theta = np.array([-1.7, 60.3, -1.9, 60.9, -1.2, 59.0, -1.4, 62.0, -3.3, 52.0])
    solution = problem.solve(theta)
    _, gamma = problem.operators(theta)

    def fit(at: np.ndarray) -> np.ndarray:
        d = form.columns(problem.v, at[problem.split :]) @ solution.coefficients
        return d + problem.operators(at)[0] @ solution.weights

    exact = problem.derivatives(solution, gamma)
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 1e-5
        numeric = (fit(theta + step) - fit(theta - step)) / 2e-5
        assert np.max(np.abs(exact[:, k] - numeric)) < 1e-4 * (1e-3 + np.max(np.abs(numeric)))


def test_operator_outputs_are_those_of_the_model() -> None:
    record = prepared()
    problem = make_problem(
        build_path([record], [FilmStart("heated")]), equal_structure(9), Form("none", True, 30.0, 90.0)
    )
    theta = np.array([-1.7, 60.3, -1.9, 60.0])
    from sim.inference.film.fit import plain_model

    solution = problem.solve(theta)
    model = plain_model(PlainFit(problem, solution), "extended_generalized_pi", "y", "heated")
    simulated, _ = model.simulate(record.inputs, model.initial_memory(float(record.inputs[0]), "heated"))
    assert np.max(np.abs(simulated + solution.residual - record.output)) < 1e-12


def test_thinned_rows_leave_the_operators_unchanged() -> None:
    record = prepared()
    few = np.zeros(record.used.size, dtype=np.bool_)
    few[::17] = True
    theta = np.array([-1.7, 60.3, -1.9, 60.9])
    outputs = []
    for chosen in (np.ones_like(few), few):
        path = build_path([record], [FilmStart("cooled")], [chosen])
        operators = make_problem(path, equal_structure(9), Form("none", True, 30.0, 90.0)).operators(theta)[0]
        outputs.append(dict(zip(path.sample.tolist(), operators, strict=True)))
    for sample, row in outputs[1].items():
        assert np.max(np.abs(row - outputs[0][sample])) < 1e-15


def test_the_smallest_radius_is_what_the_order_condition_needs() -> None:
    rng = np.random.default_rng(0)
    v = np.linspace(-300.0, 400.0, 700001)
    for _ in range(20):
        shape = np.array([rng.uniform(-3, 0), rng.uniform(50, 70), rng.uniform(-3, 0), rng.uniform(50, 70)])
        gap = np.tanh(np.exp(shape[0]) * (v - shape[1])) - np.tanh(np.exp(shape[2]) * (v - shape[3]))
        floor, gradient = radius_floor(shape)
        assert max(0.5 * gap.max(), 0.0) <= floor + 1e-9
        assert floor == pytest.approx(max(0.5 * gap.max(), 0.0), abs=1e-6)
        for k in range(4):
            step = np.zeros(4)
            step[k] = 1e-4
            numeric = (radius_floor(shape + step)[0] - radius_floor(shape - step)[0]) / 2e-4
            assert gradient[k] == pytest.approx(numeric, abs=2e-4)


def test_reduced_nonnegative_least_squares() -> None:
    rng = np.random.default_rng(1)
    m, y = np.cumsum(rng.normal(size=(300, 12)), axis=0), rng.normal(size=300)
    r = triangle(np.column_stack((m, y)))
    x, square = solve_triangle(r, 2)
    signed = np.column_stack((m, -m[:, :2]))
    reference, norm = scipy.optimize.nnls(signed, y)
    reference[:2] -= reference[12:]
    assert np.allclose(x, reference[:12], atol=1e-6)
    assert square == pytest.approx(norm**2, rel=1e-9)
    doubled = np.column_stack((m, m[:, 3], y))
    assert solve_triangle(triangle(doubled), 0)[1] <= scipy.optimize.nnls(m, y)[1] ** 2 * (1 + 1e-6)


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
    fine = denser(equal_structure(10))
    weights = np.zeros(40)
    weights[[3, 4, 20, 33]] = [0.2, 0.6, 0.5, 0.1]
    few = merged(fine, weights, 3)
    assert few.fractions.tolist() == pytest.approx([(0.2 * 3 + 0.6 * 4) / 0.8 / 40, 0.5, 33 / 40])


def plain_film(path: Path) -> PlainFit:
    problem = make_problem(path, equal_structure(6), Form("linear", True, 30.0, 90.0))
    return PlainFit(problem, problem.solve(np.array([-1.7, 63.0, -1.9, 59.0])))


def test_a_steep_wide_loop_has_its_operators_where_its_relays_switch() -> None:
    """In minor loops too, in which a mean of the branches stays on the plateau that the film is on."""
    paths = []
    for seed in (5, 6):
        v = random_profile(3000, seed)
        y = relay_film(v, spread_K=0.8, half_width_K=6.0, width_spread=0.1)
        paths.append(build_path([prepare(FilmRecord(np.arange(v.size, dtype=float), v, y))], [FilmStart("cooled")]))
    fitted, other = paths
    fit, error = fit_plane_judged(fitted, other, relays_over(fitted, 18), plain_film(fitted))
    assert error < 0.01
    heavy = fit.weights > 0.02 * np.max(fit.weights)
    assert np.median(fit.relays.half_width[heavy]) == pytest.approx(6.0, abs=1.0)


def test_the_model_of_a_preisach_density_reproduces_its_fit() -> None:
    v = decaying_profile(1200)
    record = prepare(FilmRecord(np.arange(1200.0), v, relay_film(v)))
    path = build_path([record], [FilmStart("cooled")])
    fit = fit_plane(path, relays_over(path, 12), plain_film(path), 30.0)
    model = fit.model("minus_log10_ohm", "cooled")
    simulated, _ = model.simulate(record.inputs, model.initial_memory(float(v[0]), "cooled"))
    assert np.max(np.abs(simulated - fit.at(path))) < 1e-10
    assert np.min(model.order_margin()) > -1e-12


def test_a_descent_from_a_trial_without_an_end_stays_there() -> None:
    """As of an own effect that is no number: its damping grew until numpy warned of it."""

    def linearized(at: float) -> Linearized[float]:
        nothing = np.full((2, 2), np.nan)
        return Linearized(nothing, nothing[0], nothing[0], lambda step: at)

    assert descend(1.0, 100, lambda at: np.inf, linearized, lambda before, after: False) == 1.0


def test_a_step_that_may_not_go_on_leaves_the_others_the_best_beside_it() -> None:
    """Of 1/2 x' N x - g' x within 1 of 0: both would go 50 far without ends, and cut there would be worse off."""
    normal, gradient = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([10.0, 0.5])

    def cost(x: np.ndarray) -> float:
        return float(0.5 * x @ normal @ x - gradient @ x)

    ends = -np.ones(2), np.ones(2)
    about = Linearized(normal, gradient, np.ones(2), lambda step: step, ends=ends)
    found, _ = damped_step(np.zeros(2), cost, about, 1e-12, Damping())
    assert found == pytest.approx([1.0, -0.4], abs=1e-9)
