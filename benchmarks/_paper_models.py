"""What the paper's text fixes (tables 1 to 3), what is chosen in place of the rest, and a film to try it on.

Source: J. Zhang, E. Merced, N. Sepulveda, X. Tan, Smart Mater. Struct. 23 (2014) 125017. Fixed by the text: the
parameters of envelopes and D in tables 1 and 2, the numbers of operators and the radii of sections 4.1 and 4.2,
p(r_0) = 6 and D = 5 cos v of section 5.1. Chosen: every weight but p(r_0) = 6, table 3's radii, initial states,
profiles, and the film.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memoryless

Array = NDArray[np.float64]
DECAY = 0.4  # chosen: weights fall as exp(-r / DECAY)
SPAN_PER_M = 1500.0  # chosen: of the curvature's major loop, table 1, generalized model
SPAN_DEC = 2.0  # section 4.2: "approximately two orders of magnitude"
TABLE_1_DEGC = (20.0, 80.0)  # section 4.1
TABLE_2_DEGC = (25.0, 90.0)  # chosen


def tanh(a: float, b: float) -> Envelope:
    return Envelope("tanh", a, b)


def scaled(film: FilmModel, span: float, limits_degC: tuple[float, float]) -> FilmModel:
    """The film with its weights scaled so that heating between the limits changes the output by `span`."""
    low, high = limits_degC
    plain = replace(film, memoryless=Memoryless())
    ends = plain.simulate([low, high], plain.initial_memory(low, "heated"))[0]
    d = film.memoryless
    rest = 0.0 if d.function != "tanh" else d.amplitude * float(np.ptp(np.tanh(d.a * np.array(limits_degC) + d.b)))
    return replace(film, weights=film.weights * (span - rest) / float(np.ptp(ends)))


def table_1(extended: bool) -> FilmModel:
    """Curvature (1/m) of a microcantilever: N = 15, r = i/N from 0; the weights are chosen."""
    radii = np.arange(15) / 15.0
    weights = np.exp(-radii / DECAY)
    if extended:
        d = Memoryless("sin", amplitude=40.1, a=0.17, offset=923.91)
        film = FilmModel(radii, weights, tanh(0.14, -7.19), tanh(0.18, -9.61), d, output="curvature_per_m")
    else:
        film = FilmModel(
            radii,
            weights,
            tanh(0.13, -6.94),
            tanh(0.11, -5.19),
            Memoryless(offset=914.20),
            "generalized_pi",
            "curvature_per_m",
        )
    return scaled(film, SPAN_PER_M, TABLE_1_DEGC)


def cantilever(decay: float = DECAY) -> FilmModel:
    """Table 1's extended model for a rig to track: its weights, which the text does not give, are chosen so that the
    order condition holds, 0 where the radius is below what that needs; the others fall as exp(-r / decay)."""
    film = table_1(True)
    kept = film.order_margin(*TABLE_1_DEGC) >= 0.0
    return scaled(replace(film, weights=np.where(kept, np.exp(-film.radii / decay), 0.0)), SPAN_PER_M, TABLE_1_DEGC)


def table_2(extended: bool, from_zero: bool = False) -> FilmModel:
    """-log10 R of a film: N = 30, r = i/N from 1/N (`from_zero`: from 0, so that p(r_0) exists); weights chosen."""
    radii = (np.arange(30) + (0.0 if from_zero else 1.0)) / 30.0
    weights = np.exp(-radii / DECAY)
    if extended:
        d = Memoryless("tanh", amplitude=0.4, a=0.03, b=-1.6, offset=-3.26)
        film = FilmModel(radii, weights, tanh(0.20, -11.6), tanh(0.16, -10.3), d)
    else:
        film = FilmModel(
            radii, weights, tanh(0.16, -9.5), tanh(0.14, -8.5), Memoryless(offset=-3.23), kind="generalized_pi"
        )
    return scaled(film, SPAN_DEC, TABLE_2_DEGC)


def table_3(p0: float = 6.0, d: Memoryless | None = None, others: float = 1.0) -> FilmModel:
    """Section 5.1: a classical PI model and D = 5 cos v. p(r_0) = 6 is given; radii and other weights are chosen."""
    radii = np.arange(6.0)
    weights = np.concatenate(([p0], 3.0 * others * np.exp(-radii[1:] / 2.0)))
    return FilmModel(radii, weights, IDENTITY, IDENTITY, d or Memoryless("cos", 5.0), kind="classical_pi")


class RelayFilm:
    """A film that is not of the model's class: a Preisach film with a bell-shaped density, and a slow tanh.

    4,000 relays, means N(61, 3.2) degC, half-widths lognormal with median 2.8 K and sigma 0.4; two decades between all
    down and all up, and 0.35 tanh(0.03 (T - 55)).
    """

    def __init__(self, seed: int = 1, relays: int = 4000) -> None:
        rng = np.random.default_rng(seed)
        mean, half_width = rng.normal(61.0, 3.2, relays), 2.8 * np.exp(0.4 * rng.normal(size=relays))
        self.up, self.down = mean + half_width, mean - half_width
        self.state = np.ones(relays, dtype=bool)

    def outputs(self, inputs_degC: Array) -> Array:
        """-log10 R for a sequence of temperatures; the relays stay where the last one left them."""
        shares = np.empty(inputs_degC.size)
        for k, v in enumerate(inputs_degC):
            self.state |= v > self.up
            self.state &= v >= self.down
            shares[k] = self.state.mean()
        return 2.0 * shares + 0.35 * np.tanh(0.03 * (inputs_degC - 55.0)) - 4.2


def through(turning: Array | list[float], step: float) -> Array:
    """Values through turning points, `step` apart; every turning point is met."""
    parts = [np.asarray(turning[:1], dtype=np.float64)]
    for a, b in pairwise(turning):
        parts.append(np.linspace(a, b, max(2, round(abs(b - a) / step) + 1))[1:])
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
