"""The paper's figures 3 to 8 and statements, computed: each study returns what is drawn and what is printed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks._paper_inverse import PaperInverse
from benchmarks._paper_models import (
    Array,
    RelayFilm,
    damped_oscillation,
    random_sequence,
    table_1,
    table_2,
    table_3,
    tanh,
    through,
)
from compensator.hysteresis.film import FilmModel, Memory, Memoryless
from compensator.hysteresis.functions import envelope_values, memoryless_value
from compensator.inverse.inverse import Inverse
from compensator.inverse.iteration import iterate
from sim.inference.film.compression import compress
from sim.inference.film.fit import FilmFit, identify_film

SIGMAS = (1e-4, 1e-2)
FIVE = 5
LOW_DEGC, HIGH_DEGC = 25.0, 95.0


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def d_of(film: FilmModel) -> Any:
    """D as a function of v."""
    code, par = film.memoryless.code, film.memoryless_array
    return lambda v: float(memoryless_value(code, par, v))


@dataclass(frozen=True)
class Fits:
    """Figures 3, 4 and 5: generalized and extended model on the stand-in film."""

    profile: Array
    output: Array
    random: Array
    random_output: Array
    fits: dict[str, FilmFit]
    fitted: dict[str, Array]
    predicted: dict[str, Array]

    def errors(self, name: str) -> tuple[float, float, float, float, float]:
        """RMSE and largest on the profile; RMSE, mean absolute and largest on the random sequence (decades)."""
        a, b = self.fitted[name] - self.output, self.predicted[name] - self.random_output
        return rms(a), float(np.max(np.abs(a))), rms(b), float(np.mean(np.abs(b))), float(np.max(np.abs(b)))


def fits(step: float = 0.25) -> Fits:
    """Fit three models to a damped oscillation, predict a random sequence."""
    profile = damped_oscillation(90.0, 30.0, 62.0, 10, step)
    random = random_sequence(45.0, 80.0, 40, step, 3, 90.0)
    output, random_output = RelayFilm().outputs(profile), RelayFilm().outputs(random)
    time_s = np.arange(profile.size) / 1.0
    asked: dict[str, dict[str, Any]] = {
        "generalized": {"kind": "generalized_pi"},
        "extended": {"kind": "extended_generalized_pi", "form": "tanh"},
        "default": {},
    }
    found = {
        name: identify_film(time_s, profile, output, initial="cooled", temperature_noise_K=0.0, **arguments)
        for name, arguments in asked.items()
    }
    over = {name: _simulated(fit.model, profile) for name, fit in found.items()}
    predicted = {name: _simulated(fit.model, random) for name, fit in found.items()}
    return Fits(profile, output, random, random_output, found, over, predicted)


def _simulated(film: FilmModel, inputs: Array) -> Array:
    return film.simulate(inputs, film.initial_memory(float(inputs[0]), "cooled"))[0]


@dataclass(frozen=True)
class Iterations:
    """Figures 6 and 7: the fixed point on the classical model, and the direct inverse beside it."""

    inputs: Array
    outputs: Array
    found: dict[float, Array]  # temperatures of the fixed point, by sigma
    got: Array  # the model's output at those of the smaller sigma
    counts: dict[float, float]  # mean iterations
    failures: dict[float, int]
    worst_over_sigma: dict[float, float]
    direct: Array
    evaluations: float
    round_trip: float
    unreached: int
    package_off_K: float  # `compensator.inverse.iteration` against these temperatures, largest difference


def iterations(film: FilmModel | None = None, inputs: Array | None = None) -> Iterations:
    """The model's output over a random input, inverted by both."""
    film = film or table_3()
    inputs = random_sequence(-10.0, 10.0, 24, 0.25, 2, 0.0) if inputs is None else inputs
    start = Memory(float(inputs[0]), np.clip(0.0, inputs[0] - film.radii, inputs[0] + film.radii))
    outputs, _ = film.simulate(inputs, start)
    inverse = Inverse(film, float(inputs.min()) - 20.0, float(inputs.max()) + 20.0)
    found, counts, failures, worst = {}, {}, {}, {}
    direct, evaluations, residual, package_off = np.empty(inputs.size), 0, 0.0, 0.0
    for sigma in SIGMAS:
        paper, d, memory = PaperInverse(film, start), d_of(film), start
        temperatures, numbers, bad, largest = np.empty(inputs.size), [], 0, 0.0
        for k, u in enumerate(outputs):
            converged, v, n = paper.iterate(float(u), d, sigma)
            solution = inverse.solve(float(u), memory)
            if sigma == SIGMAS[0]:
                direct[k], evaluations = solution.temperature_degC, evaluations + solution.evaluations
                residual = max(residual, abs(solution.residual))
                theirs = iterate(film, float(u), memory, sigma)
                package_off = max(package_off, abs(theirs.temperature_degC - v) if converged else 0.0)
            numbers.append(n)
            bad += not converged
            if converged:
                largest = max(largest, abs(v - solution.temperature_degC))
            temperatures[k] = v if converged else math.nan
            memory = film.step(float(inputs[k]), memory)[1]
            paper.move(float(u) - d(float(inputs[k])), float(inputs[k]))
        found[sigma], counts[sigma], failures[sigma] = temperatures, float(np.mean(numbers)), bad
        worst[sigma] = largest / sigma
    missed = int(np.sum(~np.isfinite(direct)))
    mean = evaluations / inputs.size
    got, _ = film.simulate(np.where(np.isfinite(found[SIGMAS[0]]), found[SIGMAS[0]], inputs), start)
    return Iterations(inputs, outputs, found, got, counts, failures, worst, direct, mean, residual, missed, package_off)


def iterations_elsewhere() -> list[float]:
    """Mean iterations at sigma 1e-4 with other steps of the input: how much they hang on what the text leaves open."""
    return [iterations(inputs=random_sequence(-10.0, 10.0, 24, h, 2, 0.0)).counts[1e-4] for h in (0.02, 0.1, 0.5, 2.0)]


def failures_with(p0: float, amplitude: float) -> tuple[float, float]:
    """Share of samples where the fixed point fails, and mean iterations, with other p(r_0) and amplitude of D."""
    result = iterations(table_3(p0, Memoryless("cos", amplitude)))
    return result.failures[1e-4] / result.inputs.size, result.counts[1e-4]


@dataclass(frozen=True)
class Compensation:
    """Figure 8: open-loop inverse compensation of the stand-in film with few operators."""

    wanted: Array
    temperatures: Array
    got: Array
    operators: int
    unreached: int

    @property
    def error(self) -> Array:
        return self.got - self.wanted


def compensation(film: FilmModel, operators: int) -> Compensation:
    """Temperatures from the inverse of a compressed model, given to the film without any feedback."""
    smaller = film if film.operators <= operators else compress(film, operators, 35.0, 90.0).model
    turning = [-4.3, -2.3, -4.1, -2.5, -3.9, -2.7, -3.7, -2.9, -3.5, -2.2, -3.2, -2.6, -4.0, -3.0, -3.6, -2.4, -4.3]
    wanted = through(turning, 0.02)
    inverse = Inverse(smaller, LOW_DEGC, HIGH_DEGC)
    first = inverse.first(float(wanted[0]), "cooled")
    temperatures, _ = inverse.trajectory(wanted, first.memory)
    unreached = int(np.sum(np.isnan(temperatures)))
    for k in np.flatnonzero(np.isnan(temperatures)):
        temperatures[k] = temperatures[k - 1]
    true = RelayFilm()
    true.outputs(through([HIGH_DEGC, float(temperatures[0])], 0.25))
    return Compensation(wanted, temperatures, true.outputs(temperatures), smaller.operators, unreached)


def least_radius(film: FilmModel) -> tuple[float, float]:
    """The least radius that keeps gamma_R - r <= gamma_L + r, and the temperature that asks for it (degC)."""
    v = np.linspace(-50.0, 200.0, 250001)
    half = 0.5 * (envelope_values(film.envelopes[0][:3], v) - envelope_values(film.envelopes[0][3:], v))
    return float(half.max()), float(v[half.argmax()])


def largest_jump(film: FilmModel) -> float:
    """Largest step of the output at a reversal on the major loop where the order condition fails."""
    low, high = 20.0, 95.0
    worst = 0.0
    for v in np.linspace(low, high, 301)[1:-1]:
        for initial in ("heated", "cooled"):
            memory = film.initial_memory(float(v), initial)  # type: ignore[arg-type]
            before = film.output_at(memory)
            step = 1e-9 if initial == "cooled" else -1e-9
            worst = max(worst, abs(film.step(float(v) + step, memory)[0] - before))
    return worst


@dataclass(frozen=True)
class Equation14:
    """Eq (14) on table 1's generalized model: off in temperature (K) anywhere, and where the output moved; round trip
    in the output (1/m); the widest interval in which every operator stands still (K); eq (12) against eq (6) (1/m)."""

    off_K: float
    off_moving_K: float
    round_trip: float
    stand_still_K: float
    equation_12_off: float


def equation_14() -> Equation14:
    film = table_1(extended=False)
    v = random_sequence(20.0, 80.0, 60, 0.5, 5, 20.0)
    start = film.initial_memory(20.0, "heated")
    u, _ = film.simulate(v, start)
    paper, d, found = PaperInverse(film, start), d_of(film), np.empty(v.size)
    for k in range(v.size):
        y = float(u[k]) - d(0.0)
        found[k] = paper.at(y)
        paper.move(y, float(found[k]))
    off, moving = np.abs(found - v), np.abs(np.diff(u, prepend=u[0])) > 1e-6
    again, _ = film.simulate(found, start)
    (_, a_r, b_r), (_, a_l, b_l) = film.envelopes[0][:3], film.envelopes[0][3:]
    turning = np.linspace(20.0, 80.0, 6001)
    back, on = turning - (a_r * turning + b_r - b_l) / a_l, (a_l * turning + b_l - b_r) / a_r - turning
    widths = np.concatenate((back[turning - back >= 20.0], on[turning + on <= 80.0]))
    return Equation14(
        float(off.max()),
        float(off[moving].max()),
        float(np.abs(again - u).max()),
        float(widths.max()),
        float(np.abs(_equation_12(film, v, start) - u).max()),
    )


def inside_a_jump() -> tuple[float, float, int, int]:
    """Table 2's extended model with a radius 0, D constant: outputs inside the jump of a reversal at 61 degC.

    (error of the output at eq (14)'s temperature, size of the jump, targets, how many the direct inverse declares
    unreachable).
    """
    film = replace(table_2(extended=True, from_zero=True), memoryless=Memoryless(offset=-3.26))
    memory = film.initial_memory(61.0, "heated")
    here, after = film.output_at(memory), film.step(61.0 - 1e-9, memory)[0]
    targets = np.linspace(here, after, 22)[1:-1]
    paper, inverse, worst, told = PaperInverse(film, memory), Inverse(film), 0.0, 0
    for target in targets:
        found = paper.at(float(target) - film.memoryless.offset)
        worst = max(worst, abs(film.step(found, memory)[0] - float(target)))
        told += not inverse.solve(float(target), memory).reachable
    return worst, abs(after - here), int(targets.size), told


def _equation_12(film: FilmModel, v: Array, memory: Memory) -> Array:
    """Eq (12) read literally: the classical model Pi, which knows only its input gamma(v), after the envelope."""
    w, out = memory.plays.copy(), np.empty(v.size)
    before, g_before = memory.input_degC, float(memory.plays[0] + film.radii[0])
    for k, x in enumerate(v):
        row = film.envelopes[0][:3] if x > before else film.envelopes[0][3:]
        if x != before:
            g = float(envelope_values(row, np.array([x]))[0])
            w = np.maximum(g - film.radii, w) if g > g_before else np.minimum(g + film.radii, w)
            before, g_before = float(x), g
        out[k] = film.memoryless.offset + float(film.weights @ w)
    return out


@dataclass(frozen=True)
class StandingStill:
    """Proposition 2 holds with |dD/dv|, and still the fixed point fails: shares of samples, and the direct inverse."""

    share_of_condition: float  # max |dD/dv| / (p(r_0) min gamma'), below 1
    failed: float
    wrong: float
    direct_unreached: int
    direct_off_K: float
    samples: int


def standing_still(shrink: float = 1.0) -> StandingStill:
    """Table 1's generalized envelopes, where gamma_R < gamma_L, with a D that satisfies eq (26) twice over."""
    envelopes = table_1(extended=False).envelopes[0]
    grid = np.linspace(30.0, 75.0, 2001)
    slopes = [row[1] * (1.0 - envelope_values(row, grid) ** 2) for row in (envelopes[:3], envelopes[3:])]
    radii = np.arange(15) / 15.0
    weights = np.exp(-radii / 0.4)
    least = float(np.min(slopes)) * weights[0]
    d = Memoryless("linear", amplitude=0.5 * shrink * least)
    film = FilmModel(radii, weights, tanh(0.13, -6.94), tanh(0.11, -5.19), d)
    v = random_sequence(30.0, 75.0, 60, 0.5, 5, 30.0)
    memory = film.initial_memory(30.0, "heated")
    inverse, paper, function = Inverse(film, 20.0, 95.0), PaperInverse(film, memory), d_of(film)
    failed = wrong = unreached = 0
    off = 0.0
    for x in v:
        u, after = film.step(float(x), memory)
        converged, found, _ = paper.iterate(u, function, 1e-4)
        solution = inverse.solve(u, memory)
        failed += not converged
        wrong += converged and abs(found - float(x)) > 0.1
        unreached += not solution.reachable
        off = max(off, abs(film.step(solution.temperature_degC, memory)[0] - u))
        memory = after
        paper.move(u - function(float(x)), float(x))
    return StandingStill(0.5 * shrink, failed / v.size, wrong / v.size, unreached, off, v.size)


@dataclass(frozen=True)
class SafeInterval:
    """Eq (26) with table 2's extended model: the p(r_0) that each end asks for, and the interval with others."""

    p0_low: float
    p0_high: float
    intervals: dict[float, tuple[float, float] | None]


def safe_interval() -> SafeInterval:
    film = table_2(extended=True)
    v = np.linspace(-20.0, 140.0, 1600001)
    d = film.memoryless
    slope_d = d.amplitude * d.a / np.cosh(d.a * v + d.b) ** 2
    rows = film.envelopes[0][:3], film.envelopes[0][3:]
    least = np.minimum(*(row[1] / np.cosh(row[1] * v + row[2]) ** 2 for row in rows))
    needed = slope_d / least
    ends = [float(np.interp(x, v, needed)) for x in (43.2, 74.2)]
    intervals: dict[float, tuple[float, float] | None] = {}
    for p0 in (0.1, ends[1], ends[0], 2.0):
        inside = v[needed < p0]
        intervals[p0] = (float(inside[0]), float(inside[-1])) if inside.size else None
    return SafeInterval(ends[0], ends[1], intervals)


@dataclass(frozen=True)
class StopRule:
    """D = -5 v, p(r_0) = 6, q = 5/6: the error left at |v_n - v_(n-1)| < sigma, over sigma; its bound q / (1 - q)."""

    worst: float
    bound: float


def stop_rule(sigma: float = 1e-2) -> StopRule:
    film = table_3(6.0, Memoryless("linear", -5.0))
    start = Memory(0.0, np.zeros(film.operators))
    inverse, worst = Inverse(film, -100.0, 100.0), 0.0
    for target in np.linspace(0.05, 0.9, 200):
        converged, v, _ = PaperInverse(film, start).iterate(float(target), d_of(film), sigma)
        if converged:
            worst = max(worst, abs(v - inverse.solve(float(target), start).temperature_degC) / sigma)
    return StopRule(worst, 5.0)


@dataclass(frozen=True)
class Divergence:
    """D = -8 v, p(r_0) = 6: dD/dv = -8 < 6 as eq (27) is printed. course: v_n of the first iterations to u = 1."""

    course: tuple[float, ...]
    failed: int
    targets: int
    direct_reached: int
    direct_residual: float


def divergence() -> Divergence:
    film = table_3(6.0, Memoryless("linear", -8.0), others=0.25)
    start = Memory(0.0, np.zeros(film.operators))
    inverse, d = Inverse(film, -100.0, 100.0), d_of(film)
    targets = np.linspace(-5.0, 5.0, 101)[np.r_[0:50, 51:101]]
    failed = reached = 0
    residual = 0.0
    for target in targets:
        failed += not PaperInverse(film, start).iterate(float(target), d, 1e-4)[0]
        solution = inverse.solve(float(target), start)
        reached += solution.reachable
        if solution.reachable:
            residual = max(residual, abs(solution.residual))
    paper, course, v = PaperInverse(film, start), [], 0.0
    for _ in range(8):
        v = paper.at(1.0 - d(v))
        course.append(v)
    return Divergence(tuple(course), failed, int(targets.size), reached, residual)


def missing_p0() -> tuple[str, float]:
    """What the inverse says of section 4.2's radii from 1/30, and how wide a reversal at 61 degC stands still (K)
    without a radius 0, envelopes equal to gamma_R."""
    film = table_2(extended=True)
    try:
        PaperInverse(film, film.initial_memory(60.0))
    except ValueError as refused:
        text = str(refused)
    row = film.envelopes[0][:3]
    gamma = float(envelope_values(row, np.array([61.0]))[0])
    back = (math.atanh(gamma - 2.0 / 30.0) - row[2]) / row[1]
    return text, 61.0 - back


def many_valued() -> dict[int, int]:
    """Table 1's extended model is not monotone: how many targets have how many temperatures, from 20 degC."""
    film = table_1(extended=True)
    inverse, memory = Inverse(film, 20.0, 80.0), film.initial_memory(20.0, "heated")
    numbers: dict[int, int] = {}
    low, high = inverse.reachable_interval(memory)
    for target in np.linspace(low - 10.0, high + 10.0, 400):
        n = int(inverse.solutions(float(target), memory)[0].size)
        numbers[n] = numbers.get(n, 0) + 1
    return numbers
