"""Gains of a controller's own PID: what is computed arrives in the instrument, in its own units."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from compensator.control.pid import OwnPid
from rig.core.clock import VirtualClock
from rig.drivers.registry import configured_pid, open_controller, own_fields, set_pid
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
PID = OwnPid(2.0, 6.0, 0.6)


def held(name: str, instrument: object) -> tuple[float, float, float]:
    """(% of 4 A per K, Ti in s, Td in s) as the emulated instrument's loop uses them."""
    values = getattr(instrument, "_values", None) or getattr(instrument, "values", None)
    if name == "meerstetter":
        return values[3010], values[3011], values[3012]  # type: ignore[index]
    if name == "te_technology":
        return 1e4 / values["bandwidth"], 6000.0 / values["integral"], values["derivative"] * 0.6  # type: ignore[index]
    if name == "srs_ldc500":
        return -25.0 * values["TPGN"], 1.0 / values["TIGN"], values["TDGN"]  # type: ignore[index]
    gains = instrument.outputs[1].gains  # type: ignore[attr-defined]
    return gains[0], 1000.0 / gains[1], gains[2] / 100.0


@pytest.mark.parametrize(
    ("name", "limit"), [("meerstetter", 4.0), ("te_technology", 4.0), ("srs_ldc500", 4.0), ("lakeshore", 1.0)]
)
def test_computed_gains_arrive(attach: Attach, clock: VirtualClock, plant: StillPlant, name: str, limit: float) -> None:
    pid = PID if limit > 1.0 else OwnPid(0.5, 6.0, 0.6)
    fields = own_fields(name, {}, pid, limit)
    assert fields is not None
    options = {field.option: field.value for field in fields}
    back = set_pid(fields, name, limit)
    found = configured_pid(name, options, limit)
    assert found == back
    for one, other in ((back.kp_A_per_K, pid.kp_A_per_K), (back.ti_s, pid.ti_s), (back.td_s, pid.td_s)):
        assert one == pytest.approx(other, rel=0.01)
    instrument = emulated(name, plant)
    controller = open_controller(name, attach(instrument), clock, **options)
    controller.configure(limit, (12.0, 85.0), 4.0)
    assert held(name, instrument) == pytest.approx((50.0, 6.0, 0.6), rel=0.01)


@pytest.mark.parametrize("name", ["meerstetter", "te_technology", "srs_ldc500", "lakeshore"])
def test_gains_that_are_not_given_stay(attach: Attach, clock: VirtualClock, plant: StillPlant, name: str) -> None:
    instrument, untouched = emulated(name, plant), emulated(name, StillPlant())
    before = held(name, untouched) if name != "meerstetter" else (10.0, 30.0, 0.0)
    open_controller(name, attach(instrument), clock).configure(1.0, (12.0, 85.0), 4.0)
    assert held(name, instrument) == before
    assert configured_pid(name, {}, 4.0) is None


def test_a_controller_without_a_pid_of_its_own() -> None:
    assert own_fields("tclab", {}, PID, 1.0) is None
    assert configured_pid("tclab", {}, 1.0) is None


def test_some_of_lake_shores_gains_are_refused(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    port = attach(emulated("lakeshore", plant))
    with pytest.raises(ValueError, match="all three"):
        open_controller("lakeshore", port, clock, p=10.0)
