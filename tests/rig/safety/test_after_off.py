"""A controller says "off, 0 A" while a current flows: the temperature withdraws the confirmation, and only then."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import rig.bench.assembly
from benchmarks.watch import WatchedPlant
from compensator.thermal.plate import PlateModel
from rig.safety.plate_watch import KnownPlate, PlateWatch, first_plate
from rig.safety.switching_off import HeldSetpoint, OffCheck, curves_from_table, curves_of_plate
from sim.world.plant import SimulatedPlant
from tests.peltier import Peltier
from tests.rig.small import write_bench

pytestmark = pytest.mark.usefixtures("undrawn")
PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)


def lying_after(time_s: float) -> type[SimulatedPlant]:
    """A plant whose current goes on from a time on, whatever the controller believes."""

    class Lying(SimulatedPlant):
        def set_current_A(self, current: float) -> None:
            if current != 0.0 or self.time_s < time_s:
                super().set_current_A(current)

    return Lying


@pytest.mark.parametrize(("lies_after_s", "status"), [(25.0, 11), (1e9, 0)])
def test_a_run_that_ends_with_a_current_on(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path, lies_after_s: float, status: int
) -> None:
    monkeypatch.setattr(rig.bench.assembly, "SimulatedPlant", lying_after(lies_after_s))
    path = write_bench(tmp_path, target='["start 1.5 A", "hold 30 s"]')
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(
        text.replace("first_degC = 60.0", "first_degC = 25.0").replace('model = "model.toml"\ntarget', "target")
    )
    ended, _, err = peltier("run", path, "--out", tmp_path / "run")
    assert ended == status, err
    if status:
        assert "without a current" in err
        assert "Switch the controller off by hand" in err
        document = json.loads((tmp_path / "run.part" / "run.json").read_text())
        assert document["stop"]["output_off_confirmed"] is False
    else:
        assert "NOT CONFIRMED" not in err


def test_who_ends_a_run_early_is_told_at_once_that_the_output_is_off(peltier: Peltier, tmp_path: Path) -> None:
    """Before the temperature is watched, which takes seconds; and the record says when it went off, not when that was
    over."""
    path = write_bench(tmp_path, target='["start 1.5 A", "hold 60 s"]', limits="[10, 45]")
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(
        text.replace("first_degC = 60.0", "first_degC = 25.0").replace('model = "model.toml"\ntarget', "target")
    )
    status, out, err = peltier("run", path, "--out", tmp_path / "run")
    assert status == 10, err
    told = [line for line in out.splitlines() if "output off, confirmed" in line]
    assert len(told) == 1, out
    assert "the temperature is watched, whether it agrees" in told[0]
    events = [json.loads(line) for line in (tmp_path / "run.part" / "events.jsonl").read_text().splitlines()]
    rows = (tmp_path / "run.part" / "record.csv").read_text().splitlines()
    assert events[-1]["event"] == "stop"
    assert events[-1]["time_s"] < float(rows[-1].split(",")[0]) + 0.5
    first_plate = next(event["text"] for event in events if event["event"] == "first_plate")
    assert first_plate.startswith("1 A heats by ")


def watched(current_A: float, behind_s: float = 0.0) -> PlateWatch:
    """A watch after a minute of a current. behind_s: by which currents may show late."""
    watch, degC = PlateWatch(4.0, 95.0, 20.0), 40.0
    watch.know(KnownPlate(PLATE, largest_lag_s=behind_s))
    for k in range(120):
        watch.look(0.5 * k, degC, current_A if k else 0.0)
        degC = PLATE.step(degC, current_A, 0.5)
    return watch


def looked(flows_A: float, moved_K: float = 0.0, current_A: float = 1.0) -> bool | None:
    """What the look says where `flows_A` flows after the off and the thermometer had moved by so much before."""
    watch = watched(current_A)
    courses = curves_of_plate(watch, current_A, 8.0)
    if courses is None:
        return None
    look = OffCheck(curves_from_table(json.loads(json.dumps(courses.table()))), 60.0)  # as the guard is told
    degC = watch.copy().run_on(59.5, current_A)
    for k in range(40):
        look.add(60.0 + 0.25 * k, degC + moved_K)
        degC = PLATE.step(degC, flows_A, 0.25)
    return look.agrees


def test_the_temperature_chooses() -> None:
    assert looked(0.0) is True
    assert looked(1.0) is False
    assert looked(1.0, moved_K=-10.0) is False
    assert looked(0.0, moved_K=10.0) is True


def test_a_current_that_ends_late_is_no_current_that_goes_on() -> None:
    for flows_s, agrees in ((4.5, True), (60.0, False)):
        watch = watched(1.0, behind_s=5.0)
        courses = curves_of_plate(watch, 1.0, 13.0)
        assert courses is not None
        look = OffCheck(courses, 60.0)
        degC = watch.copy().run_on(59.5, 1.0)
        for k in range(60):
            look.add(60.0 + 0.25 * k, degC)
            degC = PLATE.step(degC, 1.0 if 0.25 * k < flows_s else 0.0, 0.25)
        assert look.agrees is agrees


def test_a_small_current_shows_nothing() -> None:
    assert looked(0.0, current_A=0.1) is None


def test_nothing_is_known_of_a_plate_that_nobody_has_seen() -> None:
    assert curves_of_plate(PlateWatch(4.0, 95.0, 20.0), 1.0) is None


def after_a_hold(
    setpoint_degC: float,
    loss_per_s: float,
    lag_s: float,
    lies: bool = False,
    first_degC: float = 25.0,
    drift_K_per_s: float = 0.0,
    step_K: float = 0.01,
) -> bool | None:
    """What the look says after a plate in a room of 25 degC was held at a setpoint; None where nobody looks.

    first_degC, drift_K_per_s: of the rest before.
    """
    held = HeldSetpoint()
    for k in range(6):
        held.add(0.5 * k, round((first_degC + drift_K_per_s * 0.5 * k) / step_K) * step_K, math.nan, False)
    for k in range(20):
        held.add(60.0 + 0.5 * k, setpoint_degC + (step_K if k % 3 == 0 else 0.0), setpoint_degC, True)
    courses = held.curves()
    if courses is None:
        return None
    look, plate_degC, shown_degC = OffCheck(courses, 70.0), setpoint_degC, setpoint_degC
    for k in range(80):
        look.add(70.0 + 0.25 * k, round(shown_degC / step_K) * step_K)
        plate_degC -= 0.0 if lies else 0.25 * loss_per_s * (plate_degC - 25.0)
        shown_degC += (plate_degC - shown_degC) * -math.expm1(-0.25 / lag_s)
    return look.agrees


@pytest.mark.parametrize("setpoint_degC", [-5.0, 5.0, 45.0, 80.0])
def test_a_setpoint_that_is_still_held(setpoint_degC: float) -> None:
    """All that is known is the rest before: it is the same whatever the plate is like."""
    assert after_a_hold(setpoint_degC, 0.018, 1.0, lies=True) is False


@pytest.mark.parametrize("loss_per_s", [0.2 / 60.0, 0.018, 0.08])
@pytest.mark.parametrize("setpoint_degC", [-5.0, 5.0, 45.0, 80.0])
@pytest.mark.parametrize("lag_s", [0.2, 5.0, 10.0])
def test_a_setpoint_that_is_left(loss_per_s: float, setpoint_degC: float, lag_s: float) -> None:
    """Plates of 10 to 60 J/K, slow thermometers."""
    assert after_a_hold(setpoint_degC, loss_per_s, lag_s) is not False


def test_a_usual_plate_that_is_left_is_seen_to_leave() -> None:
    assert after_a_hold(45.0, 0.018, 1.0) is True


def test_where_the_plate_would_rest_nobody_knows() -> None:
    """Near the room; a plate that cooled down from before, and is held on its way there; a coarse thermometer."""
    assert after_a_hold(27.0, 0.018, 1.0, lies=True) is None
    assert after_a_hold(25.0, 0.018, 1.0, first_degC=60.0, drift_K_per_s=-0.6) is None
    assert after_a_hold(40.0, 0.018, 1.0, lies=True, step_K=0.1) is None
    held = HeldSetpoint()
    for k in range(40):
        held.add(0.5 * k, 45.0, 45.0, True)  # nobody saw it at rest
    assert held.curves() is None


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


def looked_at(capacity: float, seed: int, lag_s: float, current_A: float, flows: float) -> bool | None:
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
        assert looked_at(capacity, seed, lag_s, share * LIMIT_A, 0.0) is not False, seed


@pytest.mark.parametrize("capacity", [10.0, 20.0, 60.0])
@pytest.mark.parametrize("share", [0.5, -0.3])
def test_one_that_did_not_is_not(capacity: float, share: float) -> None:
    """Nothing of a current that cannot show in time; what can is told in most cases, and never taken for off."""
    said = [looked_at(capacity, seed, 0.0, share * LIMIT_A, 1.0) for seed in (2, 3)]
    assert True not in said
    if capacity < 30.0 and share > 0.0:
        assert said == [False] * 2
