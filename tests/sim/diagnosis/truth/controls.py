"""Negative controls: records in which something is wrong that has no physical cause, or nothing is to be seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.combine import TRIES, recorded_current
from tests.sim.diagnosis.truth.designs import slow_triangles
from tests.sim.diagnosis.truth.draw import Bench, draw_bench
from tests.sim.diagnosis.truth.oracle import Oracle
from tests.sim.diagnosis.truth.rig import Effects, record

Array = NDArray[np.float64]
Random = np.random.Generator
Columns = dict[str, Array]
Control = tuple[Bench, Effects, Callable[[Columns], Columns]]
INVISIBLE = 1.0  # log-likelihood that two cancelling effects may leave


def swapped(rng: Random) -> Control:
    """The ohmmeter's columns are those of another rig's record."""
    other = draw_bench(rng)
    foreign = record(other.rig, other.schedule, rng)

    def change(columns: Columns) -> Columns:
        return {**columns, "resistance_ohm": foreign["resistance_ohm"], "meter_current_A": foreign["meter_current_A"]}

    return draw_bench(rng), {}, change


def reversed_in_time(columns: Columns) -> Columns:
    """Readings from the last to the first; the currents of each step stay with their step."""
    out = {name: values[::-1].copy() for name, values in columns.items()}
    out["time_s"] = columns["time_s"][-1] - columns["time_s"][::-1]
    out["current_A"] = np.append(columns["current_A"][-2::-1], 0.0)
    return out


def time_reversed(rng: Random) -> Control:
    """The record runs backward."""
    return draw_bench(rng), {}, reversed_in_time


def cancelling(rng: Random) -> Control:
    """The ohmmeter's clock runs ahead by just what the film or the ohmmeter lags. On slow loops without
    corners in the transition nothing is left to be seen."""
    for _ in range(TRIES):
        bench = draw_bench(rng, form=0)
        bench = replace(bench, schedule=slow_triangles(rng, bench))
        tau = float(rng.uniform(0.2, 0.4))
        lag = str(rng.choice(["meter_lag", "film_lag"]))
        current = recorded_current(bench, {})
        oracle = Oracle(bench.rig, bench.schedule, current)
        while tau > 0.1:
            effects = {lag: {"tau_s": tau}, "timestamp_skew": {"skew_s": -tau}}
            if oracle.evidence(effects) < INVISIBLE:
                return bench, effects, dict
            tau *= 0.8
    raise RuntimeError("no two effects cancel")


def coarse_integrator(rng: Random) -> Control:
    """The generator itself is wrong: explicit Euler steps of 0.1 s."""
    bench = draw_bench(rng)
    return replace(bench, rig=replace(bench.rig, order=1, step_s=0.1)), {}, dict


CONTROLS: dict[str, Callable[[Random], Control]] = {
    "swapped": swapped,
    "time_reversed": time_reversed,
    "cancelling": cancelling,
    "coarse_integrator": coarse_integrator,
}
