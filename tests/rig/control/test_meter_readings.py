"""The meter is asked before a tick: the reading is there, as late as can be, and the test current of it is recorded."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from rig.__main__ import main
from rig.control.meter_readings import LONGEST_S, ROOM, MeterReadings
from rig.core.clock import VirtualClock
from rig.core.errors import InstrumentError, Refused, TimedOut
from rig.core.faults import Faults
from rig.core.reading import Reading
from rig.drivers.meter import Averaging
from rig.records.record_file import read_record
from tests.peltier import Peltier
from tests.rig.small import write_bench

EACH_S, LINE_S = 0.024, 0.035


class Meter:
    """Answers LINE_S and count integrations after it was asked; late_s: later still."""

    def __init__(self, clock: VirtualClock, filters: bool = True) -> None:
        self.clock, self.filters, self.averaging, self.late_s = clock, filters, Averaging(), 0.0
        self.asked_s: list[float] = []
        self.broken = self.lost = False

    def average(self, averaging: Averaging) -> None:
        if averaging.count > 1 and not self.filters:
            raise Refused(None, "no filter")
        self.averaging = averaging

    def start_reading(self) -> None:
        self.asked_s.append(self.clock.now_s())
        if self.broken:
            raise TimedOut("nothing")

    def finish_reading(self) -> Reading:
        if self.lost:
            raise TimedOut("nothing")
        there_s = self.asked_s[-1] + LINE_S + self.averaging.count * EACH_S + self.late_s
        self.clock.sleep_until_s(there_s)
        return Reading(1e4, there_s)

    def read(self) -> Reading:
        self.start_reading()
        return self.finish_reading()


def readings(meter: Meter, count: int | None = None) -> MeterReadings:
    return MeterReadings(meter, meter.clock, count)  # type: ignore[arg-type]


@pytest.mark.parametrize(("period_s", "count"), [(0.05, 1), (0.08, 1), (0.1, 2), (0.12, 3), (0.2, 4), (1.0, 4)])
def test_as_many_integrations_as_the_period_has_room_for(period_s: float, count: int) -> None:
    meter = Meter(VirtualClock())
    said = readings(meter).fit(period_s)
    assert meter.averaging.count == count
    assert count * EACH_S <= LONGEST_S
    assert count == 1 or LINE_S + count * EACH_S <= ROOM * period_s
    assert (f"mean of {count} integrations" in said) == (count > 1)


def test_a_meter_without_a_filter_gives_single_ones_and_a_configured_count_is_refused() -> None:
    meter = Meter(VirtualClock(), filters=False)
    assert "one integration" in readings(meter).fit(0.1)
    with pytest.raises(Faults, match=r"bench\.meter\.average: 3: .*no filter; expected 1, or nothing"):
        readings(meter, 3).fit(0.1)
    has_one = Meter(VirtualClock())
    readings(has_one, 3).fit(0.1)  # longer than the period: as it was asked for
    assert has_one.averaging.count == 3
    readings(has_one, 1).fit(1.0)
    assert has_one.averaging.count == 1


class FailsOnce(Meter):
    """One of its readings fails."""

    def __init__(self, clock: VirtualClock, failing: int, error: InstrumentError) -> None:
        super().__init__(clock)
        self.failing, self.error = failing, error

    def finish_reading(self) -> Reading:
        if len(self.asked_s) == self.failing:
            raise self.error
        return super().finish_reading()


@pytest.mark.parametrize("failing", range(1, 7))
@pytest.mark.parametrize("error", [TimedOut("nothing"), Refused(None, "its output is off")])
def test_a_reading_that_fails_leaves_single_ones_until_the_next_fit(failing: int, error: InstrumentError) -> None:
    meter = FailsOnce(VirtualClock(), failing, error)
    of = readings(meter)
    assert of.fit(0.1) == ""
    assert meter.averaging == Averaging()
    assert "mean of 2 integrations" in of.fit(0.1)
    assert of.fit(0.1) == ""


def ticks(
    meter: Meter, of: MeterReadings, count: int, period_s: float, exchange_s: float = 0.009, rest_s: float = 0.009
) -> tuple[list[float], float]:
    """(By how much each tick waited for its reading; how long before the last fetch that one was begun), s."""
    clock, waited, before_s = meter.clock, [], 0.0
    of.fit(period_s)
    of.ready()
    begin_s = clock.now_s()
    for k in range(count):
        of.begin_for(begin_s + k * period_s)
        clock.sleep_until_s(begin_s + k * period_s)
        asked_s = clock.now_s()
        clock.sleep_until_s(asked_s + exchange_s)
        of.thermometer_took(exchange_s)
        before_s = clock.now_s()
        of.fetch()
        waited.append(clock.now_s() - before_s)
        ago_s = before_s - meter.asked_s[-1]
        of.begin_before_the_command(begin_s + (k + 1) * period_s)
        clock.sleep_until_s(clock.now_s() + rest_s)
        of.rest_took(rest_s)
    return waited, ago_s


@pytest.mark.parametrize("period_s", [0.1, 0.25, 1.0])
def test_a_reading_is_there_as_the_temperature_is_and_was_begun_as_late_as_can_be(period_s: float) -> None:
    meter = Meter(VirtualClock())
    waited, ago_s = ticks(meter, readings(meter), 20, period_s)
    assert max(waited[2:]) == 0.0
    takes_s = LINE_S + meter.averaging.count * EACH_S
    assert takes_s <= ago_s <= takes_s + 0.05 * period_s + 0.01
    assert np.allclose(np.diff(meter.asked_s[-10:]), period_s, atol=1e-9)


def test_a_reading_that_comes_late_is_waited_for_and_the_next_begun_earlier() -> None:
    meter = Meter(VirtualClock())
    of = readings(meter)
    ticks(meter, of, 5, 0.25)
    meter.late_s = 0.03
    waited, _ = ticks(meter, of, 20, 0.25)
    assert waited[0] > 0.0 or waited[1] > 0.0
    assert np.mean(np.array(waited[2:]) > 0.0) < 0.5


def test_what_went_wrong_as_it_was_begun_is_told_as_it_is_fetched() -> None:
    meter = Meter(VirtualClock())
    of = readings(meter)
    of.fit(0.1)
    meter.broken = True
    of.ready()
    with pytest.raises(TimedOut):
        of.fetch()
    meter.broken = False
    fetched = of.fetch()
    assert fetched is not None
    assert fetched.is_number


def test_after_a_reading_that_was_left_and_did_not_come_nobody_asks_ahead() -> None:
    """Bringing the line in step is the next tick's: it looks at the temperature before and after."""
    meter = Meter(VirtualClock())
    of = readings(meter)
    of.fit(0.1)
    of.ready()
    meter.lost = True
    of.leave()
    asked = len(meter.asked_s)
    of.ready()
    of.begin_for(meter.clock.now_s())
    assert len(meter.asked_s) == asked
    meter.lost = False
    assert of.fetch() is not None


def test_a_reading_is_begun_before_the_command_where_there_is_no_time_for_it_after() -> None:
    """A tick that decides and commands for 40 ms of its 100: a reading begun after that would be waited for."""
    meter = Meter(VirtualClock())
    waited, _ = ticks(meter, readings(meter), 20, 0.1, rest_s=0.04)
    assert max(waited[10:]) == 0.0


def test_between_two_phases_nobody_waits_longer_than_a_period() -> None:
    """A meter that needed 1.5 s the last time: meanwhile a current may flow, and nobody looks at the temperature."""
    meter = Meter(VirtualClock())
    of = readings(meter)
    of.fit(0.1)
    meter.late_s = 1.5
    of.fetch()
    begun_s = meter.clock.now_s()
    of.ready()
    assert meter.clock.now_s() - begun_s <= 0.1 + 1e-9


@pytest.mark.parametrize(("more", "said"), [("", "mean of"), ("average = 1\n", "one integration")])
def test_a_run_says_what_its_readings_are(peltier: Peltier, tmp_path: Path, more: str, said: str) -> None:
    path = write_bench(tmp_path, changed=[("[bench.meter]\n", "[bench.meter]\n" + more)])
    peltier.succeeds("run", path, "--out", tmp_path / "run")
    events = [json.loads(line) for line in (tmp_path / "run" / "events.jsonl").read_text().splitlines()]
    assert said in next(e["text"] for e in events if e["event"] == "meter")
    record = read_record(tmp_path / "run" / "record.csv")
    age_s = record["time_s"] - record["resistance_time_s"]
    assert 0.0 < np.median(age_s) < 0.1


def test_a_row_has_the_current_that_its_reading_was_taken_with(peltier: Peltier, tmp_path: Path) -> None:
    """Though the next one, in another range maybe, has been begun by then."""
    peltier.succeeds("run", write_bench(tmp_path), "--out", tmp_path / "run")
    record = read_record(tmp_path / "run" / "record.csv")
    row_s, read_s, on_s = (record[name] for name in ("time_s", "resistance_time_s", "meter_current_time_s"))
    rows = np.flatnonzero(np.diff(record["meter_current_A"]) != 0.0) + 1
    assert rows.size
    assert np.all(on_s[rows] < read_s[rows])
    assert np.all(on_s[rows] > row_s[rows - 1] - 0.1)  # since then, and not since the change before


HEATED = '[[effects]]\nname = "self_heating"\ntheta_K_per_W = 1000.0\n'


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("heated", [False, True])
def test_one_test_current_over_the_target(tmp_path: Path, heated: bool) -> None:
    """The target passes 9.5 kohm, where the meter goes from 0.01 to 0.1 mA."""
    path = write_bench(tmp_path)
    if heated:
        model = (tmp_path / "model.toml").read_text()
        (tmp_path / "model.toml").write_text(model + HEATED)
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "record.csv").open(newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    currents = {float(row["meter_current_A"]) for row in rows if row["phase"] == "track"}
    assert currents == ({1e-5} if heated else {1e-5, 1e-4})
    events = (tmp_path / "out" / "events.jsonl").read_text()
    assert ("at most 1e-05 A" in events) == heated
