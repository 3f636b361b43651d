"""A controller says "off, 0 A" while a current flows: the temperature withdraws the confirmation, and only then."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import rig.bench.assembly
from compensator.thermal.plate import PlateModel
from rig.safety.after_off import after_off
from rig.safety.first_plate import KnownPlate
from rig.safety.plate_watch import PlateWatch
from sim.world.plant import SimulatedPlant
from tests.rig.small import write_bench

Peltier = Callable[..., tuple[int, str, str]]
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
    look = after_off(watch, current_A, 60.0, 8.0)
    if look is None:
        return None
    degC = watch.copy().run_on(59.5, current_A)
    for k in range(40):
        look.take(60.0 + 0.25 * k, degC + moved_K)
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
        look = after_off(watch, 1.0, 60.0, 13.0)
        assert look is not None
        degC = watch.copy().run_on(59.5, 1.0)
        for k in range(60):
            look.take(60.0 + 0.25 * k, degC)
            degC = PLATE.step(degC, 1.0 if 0.25 * k < flows_s else 0.0, 0.25)
        assert look.agrees is agrees


def test_a_small_current_shows_nothing() -> None:
    assert looked(0.0, current_A=0.1) is None


def test_nothing_is_known_of_a_plate_that_nobody_has_seen() -> None:
    assert after_off(PlateWatch(4.0, 95.0, 20.0), 1.0, 0.0, 8.0) is None
