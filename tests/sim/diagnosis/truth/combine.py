"""Several effects at once, each at a size that can be found beside the others."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from tests.sim.diagnosis.truth.draw import Bench, draw_bench, follows
from tests.sim.diagnosis.truth.manner import USUAL, Manner
from tests.sim.diagnosis.truth.oracle import Oracle, threshold
from tests.sim.diagnosis.truth.rig import Effects, simulate
from tests.sim.diagnosis.truth.sizes import MARGIN, PARAMETERS, SIZES, sized, weaker

# Alike and in the same link: one delays, the other delays and smooths.
ALIKE = ({"meter_lag", "timestamp_skew"},)
TRIES = 60


def allowed(names: tuple[str, ...]) -> bool:
    """Whether these can be asked for together."""
    return not any({a, b} in ALIKE for a, b in combinations(names, 2))


def drawn_names(rng: np.random.Generator, count: int) -> tuple[str, ...]:
    """So many effects that can be asked for together."""
    while True:
        names = tuple(str(name) for name in rng.choice(list(SIZES), count, replace=False))
        if allowed(names):
            return names


def recorded_current(bench: Bench, effects: Effects) -> np.ndarray:
    """The currents of a closed loop around the rig with these effects, without noise."""
    return simulate(bench.rig.having(effects), bench.schedule).current


def with_effects(
    rng: np.random.Generator,
    names: tuple[str, ...],
    film: str = "of_class",
    rows: int | None = None,
    tries: int = TRIES,
    manner: Manner = USUAL,
) -> tuple[Bench, Effects, dict[str, float]]:
    """A bench that can show these effects, their parameters, and the smallest findable size as a share of each."""
    for _ in range(tries):
        bench = draw_bench(rng, film, rows=rows, manner=manner)
        oracle = Oracle(bench.rig, bench.schedule, recorded_current(bench, {}))
        effects: Effects = {}
        shares: dict[str, float] = {}
        for name in names:
            drawn = sized(name, rng, bench, oracle)
            if drawn is None:
                break
            effects[name], shares[name] = drawn
        if len(effects) < len(names) or not follows(bench, bench.rig.having(effects)):
            continue
        if len(names) == 1 or shown_beside(bench, effects):
            return bench, effects, shares
    raise RuntimeError(f"no bench of {tries} shows {', '.join(names)}")


def shown_beside(bench: Bench, effects: Effects) -> bool:
    """Whether each effect at a fourth of its size can still be found with the others' parameters free."""
    current = recorded_current(bench, effects)
    for name, parameters in effects.items():
        if name == "thermometer_quantization":
            continue
        rest = {other: value for other, value in effects.items() if other != name}
        oracle = Oracle(bench.rig.having(rest), bench.schedule, current)
        small = {name: weaker(name, parameters, 1.0 / MARGIN)}
        if oracle.evidence(small) < threshold(PARAMETERS.get(name, 1)):
            return False
    return True
