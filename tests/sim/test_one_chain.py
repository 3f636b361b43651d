"""The simulated rig, the fits' forward model, `predict` and the observer are one chain: to rounding, in any order."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from compensator.hysteresis.functions import Array
from sim.effects import catalogue as known
from sim.effects.catalogue import add_effect
from sim.effects.effect import Effect, Parameter, Reading, switched
from tests.sim.four_ways import CURRENT, TIME, by_the_fit, coarse_differences, differences, every_effect, on

CLOSE_K, CLOSE_DEC = 1e-6, 1e-6
HEATED_DEC = 1e-5  # a fit knows the film's own resistance in the rows, and takes it as straight between them
NOISE_K, NOISE_DEC = 0.01, 0.002  # of usual instruments
CALLS = {"send": "Command", "run": "Filter", "read": "Reading", "add": "Warming", "taken": "ReadingTime"}


def soft_clamp(par: Array, values: Array) -> Array:
    """An input that draws more current the higher the resistance is."""
    return np.asarray(values / np.sqrt(1.0 + (values / par[0]) ** 2))


OWN = Effect(
    "soft_clamp",
    "ohmmeter",
    (Parameter("knee_ohm", 1e4, 1e8),),
    Reading(soft_clamp),
    "the meter's input gives way",
    "another meter",
    order=5,
)


@pytest.fixture
def with_own() -> Iterator[None]:
    """An effect of a user's own, after the ranges."""
    add_effect(OWN)
    yield
    del known._own[OWN.name]


def check(effects: tuple[Effect, ...]) -> None:
    for way, (off_K, off_dec) in differences(tuple(on(e) for e in effects)).items():
        assert off_K < CLOSE_K, (way, [e.name for e in effects])
        heated = way == "fit" and any(e.name == "self_heating" for e in effects)
        assert off_dec < (HEATED_DEC if heated else CLOSE_DEC), (way, [e.name for e in effects])


@pytest.mark.parametrize("name", [e.name for e in every_effect()])
def test_every_effect(name: str) -> None:
    effect = next(e for e in every_effect() if e.name == name)
    check((effect,))
    off_K, off_dec = coarse_differences((on(effect),), 0.5)
    assert off_K < 0.1 * NOISE_K
    assert off_dec < 0.1 * NOISE_DEC


@pytest.mark.parametrize("name", ["film_lag", "meter_lag", "creep", "sensor_lag", "timestamp_skew"])
def test_a_current_that_acts_between_rows_far_apart(name: str) -> None:
    """A lag that took a straight line from row to row would find another lag, and a skew besides."""
    late = switched(next(e for e in every_effect() if e.name == "actuator_delay"), [1.3])
    off_K, off_dec = coarse_differences((late, on(next(e for e in every_effect() if e.name == name))), 5.0)
    assert off_K < 0.1 * NOISE_K
    assert off_dec < 0.1 * NOISE_DEC


@pytest.mark.parametrize("link", ["driver", "plate", "thermometer", "film", "ohmmeter"])
def test_every_pair(link: str) -> None:
    """The one that comes later in the catalogue is given first: the order is the chain's, not the caller's."""
    pairs = [pair for pair in combinations(every_effect(), 2) if pair[0].link == link]  # 120 over all links
    for first, second in pairs:
        check((second, first))


def test_an_effect_of_ones_own(with_own: None) -> None:
    """It stands behind lag and ranges, where no effect of the catalogue does."""
    others = {e.name: e for e in every_effect()}
    check((OWN,))
    check((OWN, others["meter_lag"], others["series_resistance"]))
    check((others["timestamp_skew"], OWN, others["meter_range_error"]))


def test_a_difference_would_be_seen() -> None:
    """A shunt before the series resistance, as a chain in another order would have it."""
    shunt, series = (next(e for e in every_effect() if e.name == n) for n in ("parallel_leakage", "series_resistance"))
    given = (switched(shunt, [1e5]), switched(series, [500.0]))
    swapped = (switched(replace(shunt, order=0), [1e5]), switched(replace(series, order=1), [500.0]))
    right, wrong = (by_the_fit(effects, TIME, CURRENT)[1] for effects in (given, swapped))
    assert np.max(np.abs(right - wrong)) > 1e-4


def test_only_the_model_calls_an_effect(root: Path) -> None:
    """`form.send` and the like stand in sim/model alone; where a form is made, or asked what it is, is free."""
    found = []
    for package in ("sim", "rig", "compensator"):
        for path in (root / package).rglob("*.py"):
            if path.is_relative_to(root / "sim" / "model"):
                continue
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CALLS:
                    owner = ast.unparse(node.func.value)
                    if owner == "form" or owner.endswith((".form", "_form")):
                        found.append(f"{path.relative_to(root)}:{node.lineno}: {owner}.{node.func.attr}")
    assert not found
