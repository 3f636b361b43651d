"""What single controllers have of their own: options, units, errors in words, gains of their own regulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from compensator.control.pid import OwnPid
from rig.core.clock import VirtualClock
from rig.core.errors import Disconnected, OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.controller import OFF_S
from rig.drivers.lakeshore import LakeShoreController
from rig.drivers.meerstetter import meaning_of
from rig.drivers.registry import configured_pid, open_controller, own_fields, set_pid
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument, emulated
from sim.instruments.lakeshore import LakeShore
from sim.instruments.meerstetter import MeerstetterTec
from sim.instruments.srs_ldc500 import SrsLdc500
from sim.instruments.tclab import DEGC_PER_STEP, TcLab
from sim.instruments.te_technology import TeTechnology
from tests.rig.drivers.far_ends import scripted
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.test_conversations import TALKS

# ---- Lake Shore 335 and 336 -------------------------------------------------------------------------


Attach = Callable[[Instrument], str]


@pytest.fixture
def instrument(plant: StillPlant) -> LakeShore:
    return LakeShore(plant, update_s=0.0)


@pytest.fixture
def ls(attach: Attach, clock: VirtualClock, instrument: LakeShore) -> LakeShoreController:
    driver = open_controller("lakeshore", attach(instrument), clock)
    assert isinstance(driver, LakeShoreController)
    driver.configure(0.8, (10.0, 90.0), 5.0)
    return driver


@pytest.mark.parametrize("model", ["335", "336"])
def test_identity_and_configuration(attach: Attach, clock: VirtualClock, plant: StillPlant, model: str) -> None:
    instrument = LakeShore(plant, model=model)
    instrument.values["HTRSET", 1] = (*instrument.values["HTRSET", 1][:-2], 1.5, 1.0)
    driver = open_controller("lakeshore", attach(instrument), clock)
    assert str(driver.identify()) == f"Lake Shore {model}, serial number 335A123, firmware 1.5"
    driver.configure(1.0, (10.0, 90.0), 5.0)
    assert instrument.values["HTRSET", 1][-2:] == (1.5, 2.0)  # the heater as it was, shown as power
    assert (instrument.values["OUTMODE", 1], instrument.values["RANGE", 1]) == ((3, 1, 0), (0,))
    assert driver.own_limits().faults(1.0, (10.0, 90.0), 5.0) == []
    assert driver.own_limits().high_degC == pytest.approx(90.0)
    instrument.identity = "LSCI,MODEL340,1,1.0"
    with pytest.raises(Refused, match="340"):
        driver.identify()


def test_largest_current_of_the_heater(attach: Attach, clock: VirtualClock, instrument: LakeShore) -> None:
    driver = open_controller("lakeshore", attach(instrument), clock, max_current_A=0.707)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    assert instrument.values["HTRSET", 1] == (0.0, 1.0, 0.0, 0.707, 2.0)


@pytest.mark.parametrize(("units", "shown"), [(1, 313.15), (2, 40.0)])
def test_units_of_setpoints(attach: Attach, clock: VirtualClock, plant: StillPlant, units: int, shown: float) -> None:
    instrument = LakeShore(plant)
    instrument.values["INTYPE", "A"] = (2, 0, 1, 0, units)
    driver = open_controller("lakeshore", attach(instrument), clock)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_setpoint()
    assert plant.current_A == 0.0
    driver.set_setpoint_degC(40.0)
    assert instrument.values["SETP", 1] == pytest.approx((shown,))
    clock.sleep_until_s(clock.now_s() + 0.5)
    driver.read_temperature()
    assert plant.current_A == pytest.approx(1.0)
    with pytest.raises(ValueError, match="outside"):
        driver.set_setpoint_degC(95.0)
    with pytest.raises(Refused, match="not armed for currents"):
        driver.set_current_A(0.1)


def test_a_sensor_without_temperatures_is_refused(attach: Attach, clock: VirtualClock, instrument: LakeShore) -> None:
    instrument.values["INTYPE", "A"] = (2, 0, 1, 0, 3)
    driver = open_controller("lakeshore", attach(instrument), clock)
    with pytest.raises(Refused, match="sensor's units"):
        driver.configure(1.0, (10.0, 90.0), 5.0)


def test_what_it_says_of_itself(ls: LakeShoreController, instrument: LakeShore, plant: StillPlant) -> None:
    plant.temperature_degC = float("nan")
    assert ls.read_temperature().quality is Quality.INVALID
    assert ls.status().text == "off, open loop, sensor: invalid"
    plant.temperature_degC = 25.0
    instrument.outputs[1].heater_error = 1
    assert ls.status().is_error
    with pytest.raises(Refused, match="heater open"):
        ls.arm_current()


def test_a_late_setting(attach: Attach, clock: VirtualClock, ls: LakeShoreController, instrument: LakeShore) -> None:
    ls.arm_setpoint()
    values = instrument.values
    kept = values["SETP", 1]
    changed = instrument.changed

    def late() -> None:
        wanted, values["SETP", 1] = values["SETP", 1], kept
        instrument._plant.schedule(clock.now_s() + 0.3, lambda _: values.update({("SETP", 1): wanted}))
        instrument.changed = changed  # type: ignore[method-assign]

    instrument.changed = late  # type: ignore[method-assign]
    ls.set_setpoint_degC(40.0)
    assert values["SETP", 1] == pytest.approx((313.15,))


def test_a_setting_that_is_not_taken(ls: LakeShoreController, instrument: LakeShore) -> None:
    ls.arm_current()
    instrument.changed = lambda: instrument.values.update({("MOUT", 1): (3.0,)})  # type: ignore[method-assign]
    with pytest.raises(Refused, match="MOUT"):
        ls.set_current_A(0.5)


@pytest.mark.parametrize("rate", [0.001, 2.0])
def test_a_ramp_beyond_the_instruments_is_refused(ls: LakeShoreController, rate: float) -> None:
    with pytest.raises(ValueError, match="ramp"):
        ls.set_ramp_K_per_s(rate)


def test_two_copies_that_differ_are_asked_for_again(attach: Attach, clock: VirtualClock) -> None:
    *before, (asked, answered), _ = TALKS["lakeshore"]
    hurt = (asked, answered.replace(b"+025", b"+035", 1))
    good = (asked.replace(b"32", b"33"), answered.replace(b"021", b"032"))
    ls, conversation = scripted("lakeshore", attach, clock, [*before, hurt, good], first_token=4)
    assert ls.read_temperature().value == 25.0
    conversation.assert_over()


# ---- TCLab ------------------------------------------------------------------------------------------


@pytest.fixture
def board(plant: StillPlant) -> TcLab:
    return TcLab(plant)


def test_the_second_heater(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    board = TcLab(plant, heater=2)
    driver = open_controller("tclab", attach(board), clock, heater=2)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(1.0)
    assert board.heaters == {1: 0.0, 2: 100.0}
    assert plant.current_A == pytest.approx(1.0)
    assert board.power_limits[1] <= 100.0  # the fence never raises a limit above the firmware's own
    assert driver.off()
    assert plant.current_A == 0.0


def test_a_stop_does_not_wait_for_a_start(attach: Attach, clock: VirtualClock, board: TcLab, plant: StillPlant) -> None:
    """A board that listens at once (a Leonardo, or one whose port was opened long ago) is off at once."""
    driver = open_controller("tclab", attach(board), clock, boot_s=9.0)
    assert driver.off() is True
    assert clock.now_s() < OFF_S
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(0.5)
    protocol_sim.unregister("test-0")
    with pytest.raises(Disconnected):
        driver.read_temperature()
    protocol_sim.register("test-0", board, clock)
    driver.link.doubt()
    begin_s = clock.now_s()
    driver.read_temperature()  # a STOP may be behind this exchange, which opens the port anew
    assert driver.off() is True
    assert clock.now_s() - begin_s < OFF_S
    assert plant.current_A == 0.0


def test_a_board_that_was_opened_just_now_is_asked_once_more(attach: Attach, clock: VirtualClock, board: TcLab) -> None:
    """An Uno, which the opening has restarted, listens two seconds later; without that no start would come about."""
    heard = board.receive
    board.receive = lambda data, time_s: heard(data, time_s) if time_s > 2.0 else None  # type: ignore[method-assign]
    driver = open_controller("tclab", attach(board), clock)
    assert driver.off() is True
    assert 2.0 < clock.now_s() < 2.0 + OFF_S


def test_later_firmware(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    driver = open_controller("tclab", attach(TcLab(plant, version="2.0.1")), clock)
    plant.temperature_degC = 61.7
    assert driver.read_temperature().value == pytest.approx(61.7, abs=DEGC_PER_STEP)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(0.5)
    assert driver.status().text == "heater 1 at 50 %, heater 2 at 0 %"


# ---- SRS LDC501 -------------------------------------------------------------------------------------


def test_an_instrument_without_line_ends_is_told_so(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    for term in (0, 1):
        ldc = SrsLdc500(plant, start_s=clock.now_s())
        ldc.values["TERM"] = term
        assert open_controller("srs_ldc500", attach(ldc), clock).read_temperature().value == 25.0
        assert ldc.values["TERM"] == 3


def test_messages_fit_into_the_buffer(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    longest = 0

    class Listener(SrsLdc500):
        def receive(self, data: bytes, time_s: float) -> None:
            nonlocal longest
            longest = max(longest, *(len(line) + 1 for line in data.split(b"\n")))
            super().receive(data, time_s)

    controller = open_controller("srs_ldc500", attach(Listener(plant)), clock, first_token=200)
    controller.identify()
    controller.configure(4.321, (-100.125, 149.125), 0.0)
    controller.arm_current()
    controller.set_current_A(-4.321)
    controller.arm_setpoint()
    controller.set_setpoint_degC(149.123)
    controller.status()
    assert controller.off()
    assert 30 < longest <= 64
    with pytest.raises(ValueError, match="64"):
        controller.link.ask("TTRD?;" * 10)  # type: ignore[attr-defined]


@pytest.fixture
def ldc(plant: StillPlant) -> SrsLdc500:
    return SrsLdc500(plant)


@pytest.fixture
def controller(attach: Attach, clock: VirtualClock, ldc: SrsLdc500) -> Any:
    return open_controller("srs_ldc500", attach(ldc), clock)


@pytest.mark.parametrize(("name", "options"), [("meerstetter", {}), ("srs_ldc500", {"heating_sign": -1})])
def test_positive_heats_however_it_is_wired(
    attach: Attach, clock: VirtualClock, plant: StillPlant, name: str, options: dict[str, int]
) -> None:
    instrument: Any = emulated(name, plant, heating_sign=-1)
    if name == "meerstetter":
        instrument._values[3034] = 0  # as the firmware knows
    controller = open_controller(name, attach(instrument), clock, **options)
    controller.configure(2.0, (10.0, 95.0), 0.0)
    controller.arm_current()
    controller.set_current_A(1.5)
    assert (plant.current_A, controller.read_current().value) == (1.5, 1.5)


def test_a_setting_that_is_refused_or_not_kept(controller: Any, ldc: SrsLdc500) -> None:
    with pytest.raises(Refused, match="execution error: TMAX") as refused:
        controller.configure(2.0, (10.0, 1000.0), 0.0)
    assert refused.value.code == 1
    ldc.change_current_limit = lambda limit_A: None  # type: ignore[method-assign]
    with pytest.raises(Refused, match=r"TILM was set to 3\.0000 and reads 2"):
        controller.configure(3.0, (10.0, 95.0), 0.0)


def test_words_are_understood(controller: Any, ldc: SrsLdc500) -> None:
    controller.configure(2.0, (10.0, 95.0), 5.0)
    ldc.values["TOKN"] = 1
    controller.arm_setpoint()
    assert controller.status().text == "on, own regulation"
    assert controller.off()
    assert not controller.status().output_is_on


def test_one_that_restarted_is_found_out_by_its_register(controller: Any, ldc: SrsLdc500) -> None:
    controller.configure(2.0, (10.0, 95.0), 5.0)
    controller.arm_current()
    ldc.switch(0.0)
    ldc.values["*ESE"] = 0
    with pytest.raises(OutOfStep):
        controller.set_current_A(1.0)
    with pytest.raises(Refused, match="armed"):
        controller.set_current_A(1.0)


# ---- errors in words, and what clears them ----------------------------------------------------------


DEAD_MAN_S = 2.0


def configured(attach: Attach, clock: VirtualClock, emulator: Any, driver: str = "meerstetter") -> Any:
    controller = open_controller(driver, attach(emulator), clock)
    controller.configure(2.0, (10.0, 95.0), DEAD_MAN_S)
    return controller


@pytest.mark.parametrize("number", [183, 60])  # 60: as some firmware shows it
@pytest.mark.parametrize("arm", ["arm_current", "arm_setpoint"])
def test_arming_after_the_dead_man_has_fired(attach: Attach, clock: VirtualClock, number: int, arm: str) -> None:
    plant = StillPlant()
    controller = configured(attach, clock, MeerstetterTec(plant, watchdog_error=number))
    controller.arm_current()
    controller.set_current_A(1.0)
    clock.sleep_until_s(clock.now_s() + 3.0 * DEAD_MAN_S)
    status = controller.status()
    assert (status.is_error, status.code, plant.current_A) == (True, number, 0.0)
    assert status.meaning
    assert "--clear" in status.remedy
    getattr(controller, arm)()
    assert controller.status().output_is_on
    limits = controller.own_limits()  # a reset forgets them
    assert (limits.current_A, limits.high_degC, limits.dead_man_s) == (2.0, 95.0, DEAD_MAN_S)


@pytest.mark.parametrize("number", [11, 104, 138])
def test_arming_clears_no_other_error(attach: Attach, clock: VirtualClock, number: int) -> None:
    emulator = MeerstetterTec(StillPlant())
    controller = configured(attach, clock, emulator)
    emulator.trip(number)
    with pytest.raises(Refused, match="does not come on") as refused:
        controller.arm_current()
    assert refused.value.code == number
    assert meaning_of(number)[0] in str(refused.value)
    assert emulator.status_until_reset is not None


def test_a_device_that_is_too_hot_is_not_reset(attach: Attach, clock: VirtualClock) -> None:
    emulator = MeerstetterTec(StillPlant())
    controller = configured(attach, clock, emulator)
    emulator._measured[1063] = lambda: 71.0
    emulator.trip(60)
    with pytest.raises(Refused, match="too hot"):
        controller.arm_current()
    assert emulator.status_until_reset is not None


def test_clearing_an_error_of_the_device(attach: Attach, clock: VirtualClock) -> None:
    emulator = MeerstetterTec(StillPlant())
    controller = configured(attach, clock, emulator)
    emulator.trip(104)
    controller.clear_error()
    assert not controller.status().is_error
    assert controller.own_limits().dead_man_s == DEAD_MAN_S
    ready = emulator._ready

    def ready_and_tripped(time_s: float) -> None:
        ready(time_s)
        emulator.trip(104)

    emulator._ready = ready_and_tripped  # type: ignore[method-assign]
    with pytest.raises(Refused, match="did not clear"):
        controller.clear_error()


def test_an_unknown_number_is_told_as_one() -> None:
    assert meaning_of(999)[0] == "see the manual"
    assert "shorted" in meaning_of(133)[0]
    assert "open" in meaning_of(134)[0]


def test_srs_forgets_what_was_read(attach: Attach, clock: VirtualClock) -> None:
    controller = configured(attach, clock, SrsLdc500(StillPlant()), "srs_ldc500")
    controller.link.shout("NONSENSE 1")
    clock.sleep_until_s(clock.now_s() + 0.1)
    controller.link.start("TEON?")  # resynchronised, which forgets as well
    controller.link.finish()
    controller.transport.send(b"NONSENSE 1\n")
    clock.sleep_until_s(clock.now_s() + 0.1)
    status = controller.status()
    assert (status.is_error, status.code, status.meaning) == (True, 2, "undefined command")
    assert "forgot it" in status.remedy
    controller.clear_error()
    assert not controller.status().is_error


def test_te_technology_resets_its_latches(attach: Attach, clock: VirtualClock) -> None:
    plant = StillPlant()
    emulator = TeTechnology(plant)
    controller = configured(attach, clock, emulator, "te_technology")
    emulator.values["alarm latch"] = 1
    plant.temperature_degC = 99.0
    clock.sleep_until_s(clock.now_s() + 0.5)
    status = controller.status()
    assert status.is_error
    assert "alarm: high" in status.meaning
    assert "below the high alarm" in status.remedy
    with pytest.raises(Refused, match="did not clear"):
        controller.clear_error()
    plant.temperature_degC = 30.0
    clock.sleep_until_s(clock.now_s() + 0.5)
    controller.clear_error()
    assert not emulator._tripped


def test_a_driver_that_cannot_clear_says_so(attach: Attach, clock: VirtualClock) -> None:
    emulator = TeTechnology(StillPlant(), model="tc-48-20")
    controller = open_controller("te_technology", attach(emulator), clock, model="tc-48-20", units="degC")
    with pytest.raises(Refused, match="at the instrument"):
        controller.clear_error()


# ---- gains of their own regulation ------------------------------------------------------------------


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
    gains = instrument.values["PID", 1]  # type: ignore[attr-defined]
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
