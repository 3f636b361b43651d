"""After an off: plates, rooms and heat sinks that share nothing with `sim`, known by what one pulse told of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.watch import WatchedPlant
from rig.safety.plate_watch import PlateWatch, first_plate
from rig.safety.switching_off import OffCheck, curves_of_plate

LIMIT_A, PERIOD_S = 3.0, 0.1


class Bench:
    """A plant, and its thermometer behind it (lag_s)."""

    def __init__(self, capacity: float, seed: int, lag_s: float) -> None:
        self.plant = WatchedPlant(seed, capacity, 0.0, "", lambda _: False)
        self._lag_s, self._shown_degC = lag_s, self.plant.degC

    def after(self, seconds: float, current_A: float) -> tuple[float, float]:
        """(time, reading) when a current has been on for so long."""
        self.plant.set_current_A(current_A)
        self.plant.advance_to(self.plant.time_s + seconds)
        reading = self.plant.read_temperature_degC()
        kept = math.exp(-seconds / self._lag_s) if self._lag_s else 0.0
        self._shown_degC = reading + (self._shown_degC - reading) * kept
        return self.plant.time_s, self._shown_degC


def looked(capacity: float, seed: int, lag_s: float, current_A: float, flows: float) -> bool | None:
    """What the look says after a minute of a current, where a share of it flows on; None where it says nothing."""
    bench, watch = Bench(capacity, seed, lag_s), PlateWatch(LIMIT_A, 500.0, 20.0)
    sent = [0.0] * 15 + [0.25 * LIMIT_A] * 40 + [0.0] * 200
    rows = [(*bench.after(PERIOD_S, before_A), now_A) for before_A, now_A in zip([0.0, *sent], sent, strict=False)]
    known = first_plate(*np.array(rows).T, LIMIT_A)
    assert known is not None
    watch.know(known)
    last_A = 0.0
    for _ in range(600):
        watch.look(*bench.after(PERIOD_S, last_A), last_A)
        last_A = current_A
    courses = curves_of_plate(watch, current_A)
    if courses is None:
        return None
    look = OffCheck(courses, bench.plant.time_s)
    while not look.decided and bench.plant.time_s < look.ends_s:
        look.add(*bench.after(0.25, flows * current_A))
    return look.agrees


CAPACITIES, SHARES, LAGS_S = [10.0, 20.0, 60.0], [0.5, 0.25, -0.3], [0.0, 3.0, 15.0]
OBEYED = [  # each two of them together once in the short tests, all of them in the long ones
    pytest.param(capacity, share, lag_s, marks=[] if (i + j + k) % 3 == 0 else pytest.mark.long)
    for i, capacity in enumerate(CAPACITIES)
    for j, share in enumerate(SHARES)
    for k, lag_s in enumerate(LAGS_S)
]


@pytest.mark.parametrize(("capacity", "share", "lag_s"), OBEYED)
def test_a_controller_that_obeyed_is_believed(capacity: float, share: float, lag_s: float) -> None:
    for seed in (2, 3):
        assert looked(capacity, seed, lag_s, share * LIMIT_A, 0.0) is not False, seed


@pytest.mark.parametrize("capacity", [10.0, 20.0, 60.0])
@pytest.mark.parametrize("share", [0.5, -0.3])
def test_one_that_did_not_is_not(capacity: float, share: float) -> None:
    """Nothing of a current that cannot show in time; what can is told in most cases, and never taken for off."""
    said = [looked(capacity, seed, 0.0, share * LIMIT_A, 1.0) for seed in (2, 3)]
    assert True not in said
    if capacity < 30.0 and share > 0.0:
        assert said == [False] * 2
