"""Records that cannot tell some effects apart, and the experiment that can."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.combine import TRIES, recorded_current
from tests.sim.diagnosis.truth.draw import Bench, draw_bench
from tests.sim.diagnosis.truth.manner import USUAL
from tests.sim.diagnosis.truth.oracle import Oracle
from tests.sim.diagnosis.truth.outside import catalogue
from tests.sim.diagnosis.truth.profiles import triangles
from tests.sim.diagnosis.truth.rig import Effects, Schedule, record

Array = NDArray[np.float64]
Random = np.random.Generator
LAGS = ("film_lag", "meter_lag", "timestamp_skew")
DESIGNS = ("lags", "plate_lags")
ABOUT = (0.9, 0.94, 0.97, 0.99, 1.0, 1.01, 1.03, 1.06, 1.1)  # of a size
APART, SEEN = 2.0, 60.0  # log-likelihood below which two effects are one, and above which there is one


@dataclass(frozen=True)
class Design:
    """The bench with the poor record's schedule; the effect; it and all that the poor record cannot tell from it; the
    channels that the poor record has; the schedule that decides."""

    bench: Bench
    hidden: Effects
    alike: tuple[str, ...]
    channels: str
    decisive: Schedule


def _timed(name: str, seconds: float) -> Effects:
    return {name: {{"timestamp_skew": "skew_s", "actuator_delay": "delay_s"}.get(name, "tau_s"): seconds}}


def _small(name: str, rng: Random) -> Effects:
    return _timed(name, float(np.exp(rng.uniform(np.log(0.2), np.log(0.4)))))


def left_beside(oracle: Oracle, hidden: Effects, other: str) -> float:
    """What is left of a lag or delay beside the best lag or delay of another kind: a small one times a factor is none,
    for a lag's second moment goes with the square of its size."""
    whole = oracle.difference(hidden)
    seconds = next(iter(next(iter(hidden.values())).values()))
    rests = [oracle.rest(whole - oracle.difference(_timed(other, seconds * factor))) for factor in ABOUT]
    return min(0.5 * float(rest @ rest) for rest in rests)


def slow_triangles(rng: Random, bench: Bench) -> Schedule:
    """Full loops at two slow rates with corners outside the transition."""
    time = np.arange(USUAL.rows) * USUAL.interval_s
    start = bench.rig.plate.start_degC
    meter = bench.schedule.meter_A
    low, high = max(start + 1.0, bench.low_degC - 8.0), min(96.0, bench.high_degC + 8.0)
    fast = float(rng.uniform(0.15, 0.25))
    return Schedule(time, meter, triangles(time, start, low, high, (0.45 * fast, fast)))


def indistinguishable(bench: Bench, hidden: Effects, current: Array, channels: str) -> tuple[float, dict[str, float]]:
    """Log-likelihood of the effect, and what is left of it beside each other effect of the catalogue."""
    name = next(iter(hidden))
    plain = Oracle(bench.rig, bench.schedule, current, channels=channels)
    change = plain.rest(plain.difference(hidden))
    beside: dict[str, float] = {}
    for other in {next(iter(effect)) for effect in catalogue(bench)} - {name}:
        rows = [plain.rest(plain.difference(e)) for e in catalogue(bench) if other in e]
        span = np.linalg.svd(np.array(rows).T, full_matrices=False)[0]
        rest = change - span @ (span.T @ change)
        beside[other] = 0.5 * float(rest @ rest)
    return 0.5 * float(change @ change), beside


def drawn_design(rng: Random, design: str) -> Design:
    """A bench, an effect and a poor record of it with at least two explanations that are as good."""
    channels = "temperature" if design == "plate_lags" else "both"
    names = {"lags": LAGS, "plate_lags": ("sensor_lag", "actuator_delay")}[design]
    for _ in range(3 * TRIES):
        rich = draw_bench(rng, form=0 if design == "lags" else None)
        bench = replace(rich, schedule=slow_triangles(rng, rich))
        name = str(rng.choice(names))
        hidden = _small(name, rng)
        # with the thermometer's noise, which the loop turns into steps of the current that tell more than its ramps do
        current = record(bench.rig.having(hidden), bench.schedule, rng)["current_A"]
        seen, beside = indistinguishable(bench, hidden, current, channels)
        oracle = Oracle(bench.rig, bench.schedule, current, channels=channels)
        beside |= {o: left_beside(oracle, hidden, o) for o in names if beside.get(o, np.inf) < APART}
        alike = tuple(sorted(other for other, left in beside.items() if left < APART))
        unsure = [other for other, left in beside.items() if APART <= left < 20.0]
        if seen < SEEN or not alike or unsure:
            continue
        whole = Oracle(rich.rig, rich.schedule, recorded_current(rich, hidden))
        if whole.evidence(hidden) < SEEN:
            continue
        after = indistinguishable(rich, hidden, recorded_current(rich, hidden), "both")[1]
        if min(after.values()) < 20.0:
            continue
        return Design(bench, hidden, tuple(sorted((name, *alike))), channels, rich.schedule)
    raise RuntimeError(f"no bench makes the design {design}")
