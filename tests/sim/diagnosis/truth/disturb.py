"""What happens to records besides: outliers, gaps, missing rows, uneven sampling, missing readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.rig import Schedule

Array = NDArray[np.float64]
Random = np.random.Generator
DISTURBANCES = ("outliers", "gaps", "missing_rows", "uneven", "missing_readings")


def uneven(rng: Random, schedule: Schedule) -> Schedule:
    """The same schedule on rows that are 0.25 to 0.75 s apart; the driver holds between them."""
    n = schedule.time.size
    time = np.concatenate(([0.0], np.cumsum(rng.uniform(0.25, 0.75, n - 1))))
    time = time * min(1.0, schedule.time[-1] / time[-1])
    assert schedule.setpoint is not None
    block = schedule.meter_A[np.clip(np.searchsorted(schedule.time, time), 0, n - 1)]
    return replace(schedule, time=time, meter_A=block, setpoint=np.interp(time, schedule.time, schedule.setpoint))


def outliers(rng: Random, columns: dict[str, Array]) -> None:
    """Single readings far off, in both channels."""
    n = columns["time_s"].size
    for name, size in (("temperature_degC", 1.0), ("resistance_ohm", 0.1)):
        bad = rng.choice(n, int(n * rng.uniform(0.002, 0.01)), replace=False)
        away = rng.choice([-1.0, 1.0], bad.size) * size * np.exp(rng.uniform(-1.0, 2.5, bad.size))
        if name == "temperature_degC":
            columns[name][bad] += away
        else:
            columns[name][bad] *= 10.0**away


def keep(columns: dict[str, Array], rows: Array) -> dict[str, Array]:
    """Only these rows."""
    return {name: values[rows] for name, values in columns.items()}


def disturbed(rng: Random, columns: dict[str, Array], kinds: tuple[str, ...]) -> dict[str, Array]:
    """A copy of the record, disturbed; `uneven` has to be done before the record is taken."""
    columns = {name: values.copy() for name, values in columns.items()}
    n = columns["time_s"].size
    if "outliers" in kinds:
        outliers(rng, columns)
    if "missing_readings" in kinds:
        columns["resistance_ohm"][rng.choice(n, int(n * rng.uniform(0.01, 0.05)), replace=False)] = np.nan
        first = int(rng.integers(n // 10, 9 * n // 10))
        columns["resistance_ohm"][first : first + int(rng.integers(20, 120))] = np.nan
    stays = np.ones(n, bool)
    if "missing_rows" in kinds:
        stays[rng.choice(np.arange(10, n - 10), int(n * rng.uniform(0.003, 0.02)), replace=False)] = False
    if "gaps" in kinds:
        for _ in range(int(rng.integers(2, 5))):
            first = int(rng.integers(n // 10, 9 * n // 10))
            stays[first : first + int(rng.integers(10, 120))] = False
    return keep(columns, stays)
