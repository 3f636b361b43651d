"""The paper's statements, recomputed as far as its text fixes them: prints "what / paper / here".

    ./peltier benchmark paper

What the text does not give - all weights but p(r0) = 6, table 3's radii, initial states, raw data, the film - is
chosen. Source: J. Zhang, E. Merced, N. Sepulveda, X. Tan, Smart Mater. Struct. 23 (2014) 125017; docs/paper.md tells
what follows from the figures.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memory, Memoryless
from compensator.hysteresis.functions import envelope_inverse, envelope_values, memoryless_value
from compensator.inverse.inverse import Inverse
from sim.inference.film.compression import compress
from sim.inference.film.fit import identify_film
from tests.compensator import film_models

Array = np.ndarray
DECAY = 0.4  # weights fall as exp(-r / DECAY)
SPAN_PER_M = 1500.0  # of the curvature's major loop
SPAN_DEC = 2.0  # section 4.2: "approximately two orders of magnitude"
TABLE_1_DEGC, TABLE_2_DEGC = (20.0, 80.0), (25.0, 90.0)  # the first from section 4.1
EQUAL = 1e-9  # share of the weights' sum below which two outputs are "y(t) = y(t-)"; else rounding decides the branch
Row = tuple[str, str, str]


def tanh(a: float, b: float) -> Envelope:
    return Envelope("tanh", a, b)


def scaled(film: FilmModel, span: float, limits_degC: tuple[float, float]) -> FilmModel:
    """The film with its weights scaled so that heating between the limits changes the output by `span`."""
    low, high = limits_degC
    plain, d = replace(film, memoryless=Memoryless()), film.memoryless
    ends = plain.simulate([low, high], plain.initial_memory(low, "heated"))[0]
    rest = 0.0 if d.function != "tanh" else d.amplitude * float(np.ptp(np.tanh(d.a * np.array(limits_degC) + d.b)))
    return replace(film, weights=film.weights * (span - rest) / float(np.ptp(ends)))


def table_1(extended: bool) -> FilmModel:
    """Curvature (1/m) of a microcantilever, with weights that fall as exp(-r / DECAY)."""
    film = film_models.table_1(not extended)
    return scaled(replace(film, weights=np.exp(-film.radii / DECAY)), SPAN_PER_M, TABLE_1_DEGC)


def table_2(extended: bool) -> FilmModel:
    """-log10 R of a film, with such weights."""
    film = film_models.table_2(not extended)
    return scaled(replace(film, weights=np.exp(-film.radii / DECAY)), SPAN_DEC, TABLE_2_DEGC)


def table_3(d: Memoryless, p0: float = 6.0, others: float = 1.0) -> FilmModel:
    """Section 5.1: a classical PI model."""
    radii = np.arange(6.0)
    weights = np.concatenate(([p0], 3.0 * others * np.exp(-radii[1:] / 2.0)))
    return FilmModel(radii, weights, IDENTITY, IDENTITY, d, kind="classical_pi")


def cantilever(decay: float = DECAY) -> FilmModel:
    """Table 1's extended model for a rig to track, its weights chosen so that the order condition holds: 0 where the
    radius is below what that needs; the others fall as exp(-r / decay)."""
    film = table_1(True)
    kept = film.order_margin(*TABLE_1_DEGC) >= 0.0
    return scaled(replace(film, weights=np.where(kept, np.exp(-film.radii / decay), 0.0)), SPAN_PER_M, TABLE_1_DEGC)


def relay_film(degC: Array) -> Array:
    """-log10 R of a film that is not of the class, first hot: 4,000 relays, and a slow tanh."""
    rng = np.random.default_rng(1)
    mean, half_width = rng.normal(61.0, 3.2, 4000), 2.8 * np.exp(0.4 * rng.normal(size=4000))
    state, shares = np.ones(4000, dtype=bool), np.empty(degC.size)
    for k, v in enumerate(degC):
        state = (state | (v > mean + half_width)) & (v >= mean - half_width)
        shares[k] = state.mean()
    return np.asarray(2.0 * shares + 0.35 * np.tanh(0.03 * (degC - 55.0)) - 4.2)


def through(turning: Array | list[float], step: float) -> Array:
    """Values through turning points, `step` apart; every turning point is met."""
    parts = [np.asarray(turning[:1], dtype=np.float64)]
    parts += [np.linspace(a, b, max(2, round(abs(b - a) / step) + 1))[1:] for a, b in pairwise(turning)]
    return np.concatenate(parts)


def damped_oscillation(high: float, low: float, centre: float, cycles: int, step: float) -> Array:
    """Repeated cycles whose range decreases towards `centre`, as section 4.1 describes; from `high`."""
    turning = [high]
    for k in range(cycles):
        share = 1.0 - k / cycles
        turning += [centre - share * (centre - low), centre + (share - 0.5 / cycles) * (high - centre)]
    return through(turning, step)


def random_sequence(low: float, high: float, turns: int, step: float, seed: int, first: float) -> Array:
    """Turning points anywhere between low and high."""
    return through(np.concatenate(([first], np.random.default_rng(seed).uniform(low, high, turns))), step)


def d_of(film: FilmModel) -> Callable[[float], float]:
    """D as a function of v."""
    code, par = film.memoryless.code, film.memoryless_array
    return lambda v: float(memoryless_value(code, par, v))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


class PaperInverse:
    """Psi^-1 with its state, and the fixed point v = Psi^-1[u - D(v)], eqs (14) to (18) and (20).

    Its plays F_s[y] are driven by y alone. The state that belongs to a film's memory w is
    z_i = w_i (p_0 + .. + p_i) + sum_(j>i) p_j w_j.
    """

    def __init__(self, film: FilmModel, memory: Memory) -> None:
        p, r, w = film.weights, film.radii, memory.plays
        if r[0] != 0.0 or not p[0] > 0.0:
            raise ValueError("p(r_0) is the weight of radius 0, and divides: there is none")
        total = np.cumsum(p)
        self.radii = np.array([float(np.sum(p[:i] * (r[i] - r[:i]))) for i in range(r.size)])  # eq (16)
        self.weights = np.concatenate(([1.0 / p[0]], -p[1:] / (total[1:] * total[:-1])))  # eqs (17), (18)
        self.rows, self.equal = film.envelopes[0], EQUAL * float(total[-1])
        self.plays = np.array([w[i] * total[i] + float(p[i + 1 :] @ w[i + 1 :]) for i in range(r.size)])
        self.y, self.v = float(p @ w), memory.input_degC

    def moved(self, y: float) -> Array:
        """The plays F_s[y] after y."""
        return np.asarray(
            (np.maximum if y > self.y else np.minimum)(y + math.copysign(1.0, self.y - y) * self.radii, self.plays)
        )

    def at(self, y: float) -> float:
        """Psi^-1[y], eq (14); the state stays."""
        if abs(y - self.y) <= self.equal:
            return self.v
        gamma = self.weights[0] * y + float(self.weights[1:] @ self.moved(y)[1:])
        code, a, b = self.rows[:3] if y > self.y else self.rows[3:]
        return float(envelope_inverse(code, a, b, gamma))

    def move(self, y: float, v: float) -> None:
        """Accept v as the temperature for y."""
        if abs(y - self.y) > self.equal:
            self.plays, self.y = self.moved(y), y
        self.v = v

    def iterate(self, u: float, d: Callable[[float], float], sigma: float) -> tuple[bool, float, int]:
        """(converged, v, iterations): v_n = Psi^-1[u - D(v_(n-1))] until |v_n - v_(n-1)| < sigma, eq (20)."""
        v = self.v
        for n in range(1, 501):
            following = self.at(u - d(v))
            if not math.isfinite(following):
                return False, v, n
            if abs(following - v) < sigma:
                return True, following, n
            v = following
        return False, v, 500


def modelling() -> Iterator[Row]:
    """Sections 4.2 and 5.2: three models fitted to damped cycles of a film and tried on a random sequence, and the
    compensation by few operators, open loop."""
    profile, random = damped_oscillation(90.0, 30.0, 62.0, 10, 0.25), random_sequence(45.0, 80.0, 40, 0.25, 3, 90.0)
    output, random_output = relay_film(profile), relay_film(random)
    fits = {}
    for name, paper, asked in (
        ("generalized", "0.031; 0.034", {"kind": "generalized_pi"}),
        ("extended", "0.012; 0.012", {"kind": "extended_generalized_pi", "form": "tanh"}),
        ("this program's default", "-", {}),
    ):
        how: dict[str, Any] = {"initial": "cooled", "temperature_noise_K": 0.0, **asked}
        fits[name] = film = identify_film(np.arange(profile.size) * 1.0, profile, output, **how).model
        fit, other = (film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0] for v in (profile, random))
        yield (
            f"{name}: RMSE fitted; elsewhere, dec",
            paper,
            f"{rms(fit - output):.4f}; {rms(other - random_output):.4f}",
        )
    wanted = through(
        [-4.3, -2.3, -4.1, -2.5, -3.9, -2.7, -3.7, -2.9, -3.5, -2.2, -3.2, -2.6, -4.0, -3.0, -3.6, -2.4, -4.3], 0.02
    )
    for operators in (5, fits["extended"].operators):
        film = compress(fits["extended"], operators, 35.0, 90.0).model if operators == 5 else fits["extended"]
        inverse = Inverse(film, 25.0, 95.0)
        degC, _ = inverse.trajectory(wanted, inverse.first(float(wanted[0]), "cooled").memory)
        for k in np.flatnonzero(np.isnan(degC)):
            degC[k] = degC[k - 1]
        before = through([95.0, float(degC[0])], 0.25)
        got = relay_film(np.concatenate((before, degC)))[before.size :]
        yield f"{operators} operators: largest error, dec", "0.135", f"{np.max(np.abs(got - wanted)):.3f}"


def classical(amplitude: float, p0: float, sigma: float) -> tuple[float, float, float]:
    """Share of samples where section 5.1's fixed point fails, its mean iterations, and the direct inverse's mean
    evaluations, over a random input."""
    film = table_3(Memoryless("cos", amplitude), p0)
    inputs = random_sequence(-10.0, 10.0, 24, 0.25, 2, 0.0)
    memory = Memory(float(inputs[0]), np.clip(0.0, inputs[0] - film.radii, inputs[0] + film.radii))
    outputs, _ = film.simulate(inputs, memory)
    inverse, paper, d = (
        Inverse(film, float(inputs.min()) - 20.0, float(inputs.max()) + 20.0),
        PaperInverse(film, memory),
        d_of(film),
    )
    ways, evaluations = [], []
    for v, u in zip(inputs, outputs, strict=True):
        ways.append(paper.iterate(float(u), d, sigma))
        evaluations.append(inverse.solve(float(u), memory).evaluations)
        memory = film.step(float(v), memory)[1]
        paper.move(float(u) - d(float(v)), float(v))
    failed = float(np.mean([not converged for converged, _, _ in ways]))
    return failed, float(np.mean([n for _, _, n in ways])), float(np.mean(evaluations))


def section_5_1() -> Iterator[Row]:
    """The iteration on a classical model, and with less than it needs."""
    for sigma, paper in ((1e-4, "8.38"), (1e-2, "5.31")):
        failed, n, direct = classical(5.0, 6.0, sigma)
        yield f"iterations, sigma {sigma:g}", paper, f"{n:.2f}, {100 * failed:.0f} % fail; direct inverse {direct:.2f}"
    for p0, amplitude, paper in ((6.0, 2.5, "may not converge"), (4.0, 5.0, "converges")):
        failed, n, _ = classical(amplitude, p0, 1e-4)
        yield f"p(r0) = {p0:g}, p_0 = {amplitude:g}", paper, f"{100 * failed:.0f} % fail, {n:.1f} iterations"


def order_condition() -> Iterator[Row]:
    """The least radius that keeps gamma_R - r <= gamma_L + r, and the jump at a reversal where it is not kept."""
    v = np.linspace(-50.0, 87.0, 137001)  # the range used
    for name, film in (
        ("table 1, extended", table_1(True)),
        ("table 2, generalized", table_2(False)),
        ("table 2, extended", table_2(True)),
    ):
        half = 0.5 * (envelope_values(film.envelopes[0][:3], v) - envelope_values(film.envelopes[0][3:], v))
        jump = 0.0
        for at in np.linspace(20.0, 95.0, 301)[1:-1]:
            for initial, step in (("heated", -1e-9), ("cooled", 1e-9)):
                memory = film.initial_memory(float(at), initial)  # type: ignore[arg-type]
                jump = max(jump, abs(film.step(float(at) + step, memory)[0] - film.output_at(memory)))
        broken = int(np.sum(film.radii < half.max()))
        where = f"r >= {half.max():.3f} at {v[half.argmax()]:.1f} degC"
        yield f"order condition, {name}", "kept", f"{where}; {broken} of {film.operators} break it; jump {jump:.3g}"


def equations_12_and_14() -> Iterator[Row]:
    """Both on table 1's generalized model: eq (12) knows only its input gamma(v), after the envelope."""
    film, v = table_1(extended=False), random_sequence(20.0, 80.0, 60, 0.5, 5, 20.0)
    start = film.initial_memory(20.0, "heated")
    u, _ = film.simulate(v, start)
    w, before, g_before, literal = start.plays.copy(), 20.0, float(start.plays[0] + film.radii[0]), np.empty(v.size)
    paper, d, found = PaperInverse(film, start), d_of(film), np.empty(v.size)
    for k, x in enumerate(v):
        if x != before:
            row = film.envelopes[0][:3] if x > before else film.envelopes[0][3:]
            g = float(envelope_values(row, np.array([x]))[0])
            w = np.maximum(g - film.radii, w) if g > g_before else np.minimum(g + film.radii, w)
            before, g_before = float(x), g
        literal[k] = film.memoryless.offset + float(film.weights @ w)
        y = float(u[k]) - d(0.0)
        found[k] = paper.at(y)
        paper.move(y, float(found[k]))
    (_, a_r, b_r), (_, a_l, b_l) = film.envelopes[0][:3], film.envelopes[0][3:]
    turning = np.linspace(20.0, 80.0, 6001)
    back, on = turning - (a_r * turning + b_r - b_l) / a_l, (a_l * turning + b_l - b_r) / a_r - turning
    still = max(back[turning - back >= 20.0].max(), on[turning + on <= 80.0].max())
    yield "eq (12) read literally against eq (6), 1/m", "equal", f"off by up to {np.max(np.abs(literal - u)):.0f}"
    yield (
        "eq (14) in temperature, K",
        "exact",
        f"off by up to {np.max(np.abs(found - v)):.1f}; stands still over {still:.1f}",
    )


def convergence() -> Iterator[Row]:
    """Conditions of the fixed point that hold, and it fails; what its stop rule leaves."""
    film = table_3(Memoryless("linear", -8.0), others=0.25)
    rest, inverse, d = Memory(0.0, np.zeros(6)), Inverse(film, -100.0, 100.0), d_of(film)
    targets = np.linspace(-5.0, 5.0, 101)[np.r_[0:50, 51:101]]
    failed = sum(not PaperInverse(film, rest).iterate(float(u), d, 1e-4)[0] for u in targets)
    reached = sum(inverse.solve(float(u), rest).reachable for u in targets)
    yield "eq (27) as printed, D = -8 v", "converges", f"{failed} of {targets.size} fail; direct finds {reached}"

    rows = table_1(extended=False).envelopes[0]
    grid, radii = np.linspace(30.0, 75.0, 2001), np.arange(15) / 15.0
    slopes = [row[1] * (1.0 - envelope_values(row, grid) ** 2) for row in (rows[:3], rows[3:])]
    weights = np.exp(-radii / DECAY)
    steep = Memoryless("linear", 0.5 * float(np.min(slopes)) * weights[0])
    film = FilmModel(radii, weights, tanh(0.13, -6.94), tanh(0.11, -5.19), steep)
    memory = film.initial_memory(30.0, "heated")
    inverse, paper, d, v = (
        Inverse(film, 20.0, 95.0),
        PaperInverse(film, memory),
        d_of(film),
        random_sequence(30.0, 75.0, 60, 0.5, 5, 30.0),
    )
    failed = missed = 0
    for x in v:
        u, after = film.step(float(x), memory)
        failed += not paper.iterate(u, d, 1e-4)[0]
        missed += not inverse.solve(u, memory).reachable
        memory = after
        paper.move(u - d(float(x)), float(x))
    yield "prop. 2 met twice over with |dD/dv|", "converges", f"{100 * failed / v.size:.0f} % fail; direct {missed}"

    film = table_3(Memoryless("linear", -5.0))
    inverse, d, worst = Inverse(film, -100.0, 100.0), d_of(film), 0.0
    for u in np.linspace(0.05, 0.9, 200):
        converged, found, _ = PaperInverse(film, rest).iterate(float(u), d, 1e-2)
        if converged:
            worst = max(worst, abs(found - inverse.solve(float(u), rest).temperature_degC) / 1e-2)
    yield "stop rule: error left, in sigma, q = 5/6", "1 (implied)", f"{worst:.2f}, bound 5"


def other_statements() -> Iterator[Row]:
    """Sections 4.2 and 3: the missing p(r0), the safe interval, and how many temperatures a target has."""
    film = table_2(extended=True)
    try:
        PaperInverse(film, film.initial_memory(60.0))
    except ValueError as refused:
        yield "section 4.2: p(r0) with r = 1/30 .. 1", "needed by (17)", f"refused: {refused}"
    d, rows = film.memoryless, (film.envelopes[0][:3], film.envelopes[0][3:])
    for v in (43.2, 74.2):
        least = min(row[1] / np.cosh(row[1] * v + row[2]) ** 2 for row in rows)
        needed = d.amplitude * d.a / np.cosh(d.a * v + d.b) ** 2 / least
        yield f"safe interval: p(r0) that {v:g} degC asks for", "one p(r0)", f"{needed:.2f}"
    film = table_1(extended=True)
    inverse, memory = Inverse(film, 20.0, 80.0), film.initial_memory(20.0, "heated")
    low, high = inverse.reachable_interval(memory)
    numbers = Counter(inverse.solutions(float(u), memory)[0].size for u in np.linspace(low - 10.0, high + 10.0, 400))
    text = ", ".join(f"{count} have {number}" for number, count in sorted(numbers.items()))
    yield "table 1, extended: temperatures of 400 targets", "one", text


def main() -> int:
    print(f"{'what':<50} {'paper':<18} here")
    for part in (modelling, section_5_1, order_condition, equations_12_and_14, convergence, other_statements):
        for what, paper, here in part():
            print(f"{what:<50} {paper:<18} {here}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
