"""Film models for the tests: the paper's, random ones of the whole family, and a plain model written from eq (6)."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import erf

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memory, Memoryless

MEMORYLESS = ("none", "tanh", "sin", "cos", "linear", "polynomial", "arrhenius")
PLAIN = {"tanh": np.tanh, "erf": erf, "arctan": lambda s: np.arctan(s) / (0.5 * math.pi), "linear": lambda s: s}
Rng = np.random.Generator
TEN_OPERATORS = FilmModel(  # 0.8 of hysteresis about 60 degC, of a film that bends little besides
    np.arange(1, 11) / 11.0,
    np.full(10, 0.08),
    Envelope("tanh", 0.2, -12.4),
    Envelope("tanh", 0.2, -11.6),
    Memoryless("linear", 1.0, 0.008, -0.48, -4.0),
)
THIRTY_OPERATORS = FilmModel(  # 1.5 of hysteresis about 57 degC, beside a curve of its own
    np.arange(1, 31) / 30.0,
    np.full(30, 0.05),
    Envelope("tanh", 0.2, -11.6),
    Envelope("tanh", 0.2, -11.2),
    Memoryless("tanh", 0.4, 0.03, -1.6, -3.26),
)


def tanh(a: float, b: float) -> Envelope:
    return Envelope("tanh", a, b)


def tanh_envelope(rng: Rng) -> Envelope:
    """Steepness 0.05 .. 0.5 1/K, centre 58 .. 72 degC."""
    a = float(rng.uniform(0.05, 0.5))
    return Envelope("tanh", a, -a * float(rng.uniform(58.0, 72.0)))


def increasing(rng: Rng) -> Memoryless:
    """A memoryless function that increases everywhere."""
    amplitude, offset = float(rng.uniform(0.0, 1.0)), float(rng.uniform(-4.0, 1.0))
    a = float(rng.uniform(0.01, 0.1))
    match rng.integers(5):
        case 0:
            return Memoryless("none", offset=offset)
        case 1:
            return Memoryless("tanh", amplitude, a, -a * float(rng.uniform(40.0, 80.0)), offset)
        case 2:
            return Memoryless("linear", amplitude, 0.1 * a, 0.0, offset)
        case 3:
            return Memoryless("arrhenius", -800.0 * amplitude, offset=offset)
        case _:
            return Memoryless("polynomial", offset=offset, coefficients=(0.1, 1e-3 * amplitude, 0.0, 1e-8))


def any_memoryless(rng: Rng, scale: float) -> Memoryless:
    """Any memoryless function, increasing or not, of some `scale` in the output's unit."""
    size, offset = scale * float(rng.uniform(-1.5, 1.5)), scale * float(rng.uniform(-2.0, 2.0))
    name = str(rng.choice(MEMORYLESS))
    a = float(rng.uniform(0.02, 0.4))
    if name in ("sin", "cos") and rng.random() < 0.1:
        a = float(rng.uniform(0.4, 2.0))
    b = float(rng.uniform(-10.0, 10.0)) if name != "tanh" else -a * float(rng.uniform(30.0, 90.0))
    if name == "linear":
        return Memoryless(name, size, 0.01 * float(rng.uniform(-1.0, 1.0)), b, offset)
    if name == "arrhenius":
        return Memoryless(name, 1000.0 * size, offset=offset)
    if name == "polynomial":
        centre, powers = float(rng.uniform(20.0, 90.0)), rng.uniform(-1.0, 1.0, int(rng.integers(1, 6)))
        polynomial = np.polynomial.Polynomial([0.0])
        for k, power in enumerate(powers):
            polynomial += size * power * np.polynomial.Polynomial([-centre / 60.0, 1.0 / 60.0]) ** k
        return Memoryless(name, offset=offset, coefficients=tuple(float(c) for c in polynomial.coef))
    return Memoryless(name, size, a, b, offset)


def monotone_model(rng: Rng) -> FilmModel:
    """A monotone extended generalized PI model that keeps the order condition."""
    count = int(rng.integers(1, 31))
    function = str(rng.choice(["tanh", "tanh", "erf", "arctan"]))
    rising, falling = (replace(tanh_envelope(rng), function=function) for _ in range(2))
    v = np.linspace(-60.0, 210.0, 20001)
    gap = plain_envelope(rising, v) - plain_envelope(falling, v)
    least = max(0.5 * float(gap.max()), 0.0) + 1e-6
    radii = np.sort(rng.uniform(least, max(least + 0.1, 1.0), count))
    return FilmModel(radii, rng.uniform(0.0, 0.3, count), rising, falling, increasing(rng))


def any_model(rng: Rng) -> FilmModel:
    """A model of the whole family: every kind, every memoryless function, the order condition kept or not."""
    count = int(rng.integers(1, 31))
    scale = 1.0 if rng.random() < 0.7 else float(10.0 ** rng.uniform(1.0, 3.0))
    weights = scale * rng.uniform(0.0, 0.5, count) * (rng.random(count) < 0.9)
    d = any_memoryless(rng, scale)
    match rng.integers(4):
        case 0:
            radii = np.sort(rng.uniform(0.0, 10.0, count))
            radii[0] *= float(rng.random() < 0.5)
            return FilmModel(radii, 0.05 * weights, IDENTITY, IDENTITY, d, "classical_pi")
        case 1:
            d = Memoryless("none", offset=d.offset)
            kind = "generalized_pi"
        case 2:
            kind = "extended_generalized_pi"
        case _:
            radii = rng.uniform(0.0, 1.2, count)
            rising = tuple(any_envelope(rng) for _ in range(count))
            falling = tuple(any_envelope(rng) for _ in range(count))
            return FilmModel(radii, weights, rising, falling, d, "mixed_envelopes")
    rising, falling = any_envelope(rng), any_envelope(rng)
    radii = np.sort(rng.uniform(0.0, 1.0, count)) + 0.8 * float(rng.random() < 0.3)
    return FilmModel(radii, weights, rising, falling, d, kind)


def any_envelope(rng: Rng) -> Envelope:
    """Often a tanh, else another function of about the same steepness."""
    curve = tanh_envelope(rng)
    if rng.random() < 0.15:
        return Envelope("linear", 0.2 * curve.a, 0.2 * curve.b)
    return replace(curve, function=str(rng.choice(["tanh", "tanh", "erf", "arctan"])))


def damped_path(rng: Rng, samples: int, low: float = 10.0, high: float = 95.0) -> np.ndarray:
    """A path with turning points everywhere: random turning points, random steps between them."""
    turns = rng.uniform(low, high, max(2, samples // 8))
    pieces = [np.linspace(a, b, int(rng.integers(2, 12)), endpoint=False) for a, b in pairwise(turns)]
    return np.resize(np.concatenate(pieces), samples)


def table_1(generalized: bool, weights: np.ndarray | None = None) -> FilmModel:
    """Paper, table 1 (curvature, 1/m): envelopes and D as printed; the weights are not in the text, all equal here."""
    curves: tuple[Any, ...] = (tanh(0.14, -7.19), tanh(0.18, -9.61), Memoryless("sin", 40.1, 0.17, 0.0, 923.91))
    if generalized:
        curves = (tanh(0.13, -6.94), tanh(0.11, -5.19), Memoryless("none", offset=914.20), "generalized_pi")
    weights = np.full(15, 60.0) if weights is None else weights
    return FilmModel(np.arange(15) / 15, weights, *curves, output="curvature_per_m")


def table_2(generalized: bool) -> FilmModel:
    """Paper, table 2 (log resistance): r = i/30, i = 1 .. 30; the weights are not in the text, all equal here."""
    curves: tuple[Any, ...] = (tanh(0.20, -11.6), tanh(0.16, -10.3), Memoryless("tanh", 0.4, 0.03, -1.6, -3.26))
    if generalized:
        curves = (tanh(0.16, -9.5), tanh(0.14, -8.5), Memoryless("none", offset=-3.23), "generalized_pi")
    return FilmModel(np.arange(1, 31) / 30.0, np.full(30, 0.05), *curves)


def plain_outputs(model: FilmModel, inputs: np.ndarray, memory: Memory) -> np.ndarray:
    """The model sample by sample in plain Python with math.tanh, written from eqs (6), (9): a second opinion."""

    count = model.operators
    rising = model.rising if isinstance(model.rising, tuple) else (model.rising,) * count
    falling = model.falling if isinstance(model.falling, tuple) else (model.falling,) * count
    plays, before, outputs = list(memory.plays), memory.input_degC, []
    for v in inputs:
        for j in range(count):
            if v > before:
                plays[j] = max(plain_envelope(rising[j], v) - model.radii[j], plays[j])
            elif v < before:
                plays[j] = min(plain_envelope(falling[j], v) + model.radii[j], plays[j])
        before = v
        outputs.append(
            plain_memoryless(model.memoryless, v) + sum(p * w for p, w in zip(model.weights, plays, strict=True))
        )
    return np.array(outputs)


def plain_envelope(envelope: Envelope, v: Any) -> Any:
    """gamma(v) of a temperature or of many, written from eqs (28), (29)."""
    return PLAIN[envelope.function](envelope.a * v + envelope.b)


def plain_memoryless(d: Memoryless, v: float) -> float:
    """D(v), written from eqs (30), (31)."""
    s = d.a * v + d.b
    match d.function:
        case "none":
            return d.offset
        case "polynomial":
            return d.offset + sum(c * v**k for k, c in enumerate(d.coefficients))
        case "arrhenius":
            return d.offset + d.amplitude / (v + 273.15)
        case "linear":
            return d.offset + d.amplitude * s
    return d.offset + d.amplitude * float(getattr(math, d.function)(s))
