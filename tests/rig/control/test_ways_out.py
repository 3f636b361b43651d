"""Every way out of a run: the output is off first, then rows are flushed, then the rest; trips keep their data."""

from __future__ import annotations

import errno
import json
import re
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import rig.bench.assembly
from rig.control.loop import Loop
from rig.core.outcome import Stopped, Tripped
from rig.drivers.meerstetter import MeerstetterController
from rig.guard.stale_run import write_end
from rig.records.run_folder import RunFolder
from sim.world.plant import SimulatedPlant
from tests.peltier import Peltier
from tests.rig.drivers.disobedient import Disobedient
from tests.rig.small import change_instrument, no_file_above, write_bench

pytestmark = pytest.mark.usefixtures("undrawn")
limited = pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="file sizes are limited on POSIX only")


@pytest.fixture
def order(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What happened, in order: off, flush, stop, as long as a run folder is open."""
    happened: list[str] = []
    told = {
        "off": (MeerstetterController, "off"),
        "flush": (RunFolder, "flush"),
        "stop": (RunFolder, "stop"),
        "abandon": (RunFolder, "abandon"),
    }
    for name, (owner, method) in told.items():
        whole = getattr(owner, method)

        def noted(self: Any, *args: Any, _name: str = name, _whole: Any = whole, **more: Any) -> Any:
            happened.append(_name)
            return _whole(self, *args, **more)

        monkeypatch.setattr(owner, method, noted)
    return happened


def at_row(monkeypatch: pytest.MonkeyPatch, number: int, action: Callable[[], None]) -> None:
    """Do something when a row is to be written."""
    whole = RunFolder.row

    def row(self: RunFolder, values: tuple[Any, ...]) -> None:
        if len(self.rows) == number:
            action()
        whole(self, values)

    monkeypatch.setattr(RunFolder, "row", row)


def raising(error: BaseException) -> Callable[[], None]:
    def act() -> None:
        raise error

    return act


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (Stopped(signal.SIGTERM), 143, "stopped by SIGTERM"),
        (Stopped(signal.SIGHUP), 129, "stopped by SIGHUP"),
        (KeyboardInterrupt(), 130, "stopped by SIGINT"),
        (OSError(errno.ENOSPC, "No space left on device"), 1, "No space left on device"),
        (Tripped("test", "a test trips", 0.0), 10, "a test trips"),
    ],
)
def test_off_first(
    monkeypatch: pytest.MonkeyPatch,
    peltier: Peltier,
    tmp_path: Path,
    order: list[str],
    error: BaseException,
    status: int,
    said: str,
) -> None:
    at_row(monkeypatch, 100, raising(error))
    got, _, err = peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert got == status
    assert said in err
    assert "output off, confirmed by the controller" in err
    assert order[:2] == ["off", "off"]  # when the bench was opened, and while the first plate was reckoned
    assert order[2:5] == ["off", "flush", "stop"]
    document = json.loads((tmp_path / "run.part" / "run.json").read_text())
    assert document["stop"]["output_off_confirmed"] is True
    assert len((tmp_path / "run.part" / "record.csv").read_text().splitlines()) == document["stop"]["rows"] + 1


def test_an_exception_that_nobody_expects(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path, order: list[str]
) -> None:
    at_row(monkeypatch, 50, raising(ZeroDivisionError("a bug")))
    with pytest.raises(ZeroDivisionError):
        peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert order[2:5] == ["off", "flush", "stop"]
    assert json.loads((tmp_path / "run.part" / "run.json").read_text())["stop"]["reason"] == "ZeroDivisionError"


def test_a_full_disk(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path, order: list[str]) -> None:
    """Nothing at all can be written any more: the output is off all the same, and the first error is the one told."""
    full = OSError(errno.ENOSPC, "No space left on device")

    def refuse(self: RunFolder, *_: Any, **__: Any) -> None:
        raise full

    def fill() -> None:
        for method in ("flush", "event", "_write_document"):
            monkeypatch.setattr(RunFolder, method, refuse)
        raise full

    at_row(monkeypatch, 100, fill)
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=1)
    assert "No space left on device; " in err
    assert err.count("No space left on device") == err.count("is not whole") == 1  # it is the reason of all of them
    assert "output off, confirmed by the controller" in err
    assert order[1] == "off"
    assert order[-2:] == ["abandon", "off"]  # the bench's own, at its end


@limited
def test_a_file_that_may_not_grow(peltier: Peltier, tmp_path: Path, order: list[str]) -> None:
    """Bytes are refused in the middle of a run."""
    path = write_bench(tmp_path)
    with no_file_above(20_000):
        status, _, err = peltier("run", path, "--out", tmp_path / "run")
    assert status == 1
    assert f"File too large: '{tmp_path / 'run.part' / 'record.csv'}'; " in err  # what failed first, and its file
    assert "output off, confirmed by the controller" in err
    assert order[1] == "off"
    assert (tmp_path / "run.part" / "record.csv").stat().st_size <= 20_000


@limited
@pytest.mark.parametrize("writes", ["the run itself", "its guard"])
def test_an_end_that_finds_no_room_leaves_the_document_as_it_was(writes: str, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run", {}, "", ["time_s"])
    before = {path.name for path in folder.part.iterdir()}
    with no_file_above(60):
        if writes == "its guard":
            write_end(str(folder.part), "the process died", True)
        else:
            with pytest.raises(OSError, match=re.escape("run.json'")):
                folder.stop("done")
    folder.abandon()
    assert {path.name for path in folder.part.iterdir()} == before
    assert "stop" not in json.loads((folder.part / "run.json").read_text())


def test_a_deleted_folder_is_written_again(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    at_row(monkeypatch, 100, lambda: shutil.rmtree(tmp_path / "run.part"))
    assert peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")[0] == 0
    rows = len((tmp_path / "run" / "record.csv").read_text().splitlines()) - 1
    assert rows == json.loads((tmp_path / "run" / "run.json").read_text())["stop"]["rows"] > 100
    events = [json.loads(line) for line in (tmp_path / "run" / "events.jsonl").read_text().splitlines()]
    assert {"phase", "deleted"} <= {event["event"] for event in events}
    assert (tmp_path / "run" / "config.toml").exists()


def test_a_trip_keeps_its_cause_and_the_data_around_it_and_its_loop_runs_nothing_more(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path
) -> None:
    """Who comes in the morning sees what happened; and no second phase of the program heats what has tripped."""
    loops: list[Loop] = []
    whole = Loop.__init__

    def kept(self: Loop, *args: Any, **more: Any) -> None:
        whole(self, *args, **more)
        loops.append(self)

    monkeypatch.setattr(Loop, "__init__", kept)
    at_row(monkeypatch, 100, raising(Tripped("test", "a test trips", 0.0)))
    assert peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")[0] == 10
    trip = json.loads((tmp_path / "run.part" / "trip.json").read_text())
    assert trip["cause"] == "test"
    assert trip["text"] == "a test trips"
    assert trip["limits"]["high_degC"] == 95.0
    assert len(trip["rows"]) == 100
    assert len(trip["rows"][0]) == len(trip["columns"])
    with pytest.raises(Tripped, match="a test trips"):
        loops[0].phase("again", None, 1.0, 0.1)  # type: ignore[arg-type]


def tampered(monkeypatch: pytest.MonkeyPatch, method: str, after_s: float, wrong: Callable[..., Any]) -> None:
    """From a time on the simulated plant does something else: `wrong` is given the plant and what it does rightly."""
    right = getattr(SimulatedPlant, method)

    def does(self: SimulatedPlant, *values: float) -> Any:
        if self.time_s < after_s:
            return right(self, *values)
        return wrong(self, right, *values)

    monkeypatch.setattr(SimulatedPlant, method, does)


def frozen(plant: Any, read: Callable[[Any], float]) -> float:
    if not hasattr(plant, "frozen_degC"):
        plant.frozen_degC = read(plant)
    value: float = plant.frozen_degC
    return value


def jumps(plant: Any, read: Callable[[Any], float]) -> float:
    return read(plant) - 25.0


def open_circuit(plant: Any, set_current: Callable[[Any, float], None], current_A: float) -> None:
    set_current(plant, 0.0)


@pytest.mark.parametrize(
    ("method", "wrong", "causes", "said"),
    [
        ("read_temperature_degC", frozen, {"thermometer_stale", "unseen_heat"}, "thermometer"),
        ("read_temperature_degC", jumps, {"thermometer_stale"}, "is a jump from"),
        ("set_current_A", open_circuit, {"unseen_heat", "disturbed"}, "the current that was sent"),
    ],
)
def test_what_goes_wrong_in_mid_run_trips(
    monkeypatch: pytest.MonkeyPatch,
    peltier: Peltier,
    tmp_path: Path,
    method: str,
    wrong: Callable[..., Any],
    causes: set[str],
    said: str,
) -> None:
    tampered(monkeypatch, method, 20.0, wrong)
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=10)
    assert said in err
    assert "output off, confirmed" in err
    trip = json.loads((tmp_path / "run.part" / "trip.json").read_text())
    assert trip["cause"] in causes
    if trip["cause"] == "thermometer_stale":
        document = json.loads((tmp_path / "run.part" / "run.json").read_text())
        assert document["stop"]["readings_rejected"]["thermometer"] > 10


@pytest.mark.parametrize("verb", ["run", "calibrate"])
@pytest.mark.parametrize("first_degC", [30.0, 60.0, 93.0])
def test_polarity_is_checked_with_a_small_pulse(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path, verb: str, first_degC: float
) -> None:
    change_instrument(monkeypatch, "controller", lambda one: setattr(one, "_heating_sign", -1) or one)
    path = write_bench(tmp_path, changed=[("first_degC = 60.0", f"first_degC = {first_degC}")])
    assert "polarity" in peltier.fails(verb, path, "--out", tmp_path / "run", status=10)
    trip = json.loads((tmp_path / "run.part" / "trip.json").read_text())
    assert trip["cause"] == "polarity"
    row = {name: [r[k] for r in trip["rows"]] for k, name in enumerate(trip["columns"])}
    assert set(row["phase"]) == {"polarity"}
    assert max(abs(current) for current in row["current_A"]) <= 1.0
    highest, lowest = max(row["temperature_degC"]), min(row["temperature_degC"])
    assert highest < first_degC + 6.0
    assert lowest > min(first_degC - 30.0, 20.0)  # a plate at 93 degC cools by itself meanwhile


SLOW = """
[[simulation.effects]]
name = "actuator_delay"
delay_s = 4.0
[[simulation.effects]]
name = "sensor_lag"
tau_s = 8.0
"""


def test_a_plate_that_drifts_has_no_wrong_polarity(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, more=SLOW)
    peltier("run", path, "--out", tmp_path / "run")  # the law does not know the delay: how it ends is another matter
    folder = next(tmp_path.glob("run*"))
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert "1 A heats" in [event["text"] for event in events if event["event"] == "polarity"]


def test_no_answer_to_the_pulse(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    tampered(monkeypatch, "set_current_A", 0.0, open_circuit)
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=10)
    assert "is the Peltier connected" in err


def test_a_gap_in_mid_run_trips(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    """The program was asleep for a while: nobody knows what plate and film did, though the next reading is good."""
    whole = rig.bench.assembly.VirtualClock.sleep_until_s
    slept = []

    def sleep(self: Any, time_s: float) -> None:
        asleep = sys._getframe(1).f_code.co_name == "_phase"  # the loop itself, not a port that waits
        if asleep and time_s > 26.0 and not slept:  # the plate is heated then
            slept.append(True)
            time_s += 3.0
        whole(self, time_s)

    monkeypatch.setattr(rig.bench.assembly.VirtualClock, "sleep_until_s", sleep)
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=10)
    assert "this program did not read for 3." in err
    trip = json.loads((tmp_path / "run.part" / "trip.json").read_text())
    assert trip["cause"] == "program_late"


def test_a_film_that_the_hot_end_does_not_saturate_is_told(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, target='["start 40 kohm", "hold 5 s"]')
    path.write_text(path.read_text() + "\n[calibration]\ntemperature_degC = [30, 60]\n")
    status, out, err = peltier("run", path, "--out", tmp_path / "run")
    assert "still remembers what was before" in out, err
    assert status in (0, 2)
    assert "still remembers" not in peltier("run", write_bench(tmp_path), "--out", tmp_path / "second")[1]


def test_a_calibration_below_the_transition_has_failed_and_not_tripped(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    path.write_text(path.read_text() + "\n[calibration]\ntemperature_degC = [16, 28]\n")
    err = peltier.fails("calibrate", path, "--out", tmp_path / "run", status=1)
    assert "does calibration.temperature_degC span its transition?" in err
    assert "output off, confirmed" in err
    assert not (tmp_path / "run.part" / "trip.json").exists()
    assert json.loads((tmp_path / "run.part" / "run.json").read_text())["stop"]["reason"] == "no_transition"


def test_more_cooling_current_than_cools_is_refused(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, target='["start 0 A", "hold 2 s", "step to -9 A", "hold 2 s"]')
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(text.replace("current_A = 4.0", "current_A = 10.0"))
    err = peltier.fails("run", path, "--out", tmp_path / "run")
    assert "more current cools less" in err
    assert "experiment.target" in err


def test_a_controller_without_a_dead_man_is_told(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, target='["start 0 A", "hold 2 s"]')
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(
        text.replace('driver = "meerstetter"', 'driver = "srs_ldc500"').replace("period_s = 0.1", "period_s = 0.5")
    )
    out = peltier.succeeds("run", path, "--out", tmp_path / "run")
    assert "srs_ldc500: has no dead man of its own" in out
    assert json.loads((tmp_path / "run" / "run.json").read_text())["start"]["dead_man"] is False


# ---- a controller that does not obey -------------------------------------------------------------------------------


@pytest.fixture
def disobeys(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[Disobedient]]:
    """The controller of the simulated bench does not obey any more from the hundredth row on, where a test trips."""

    def make(fault: str) -> list[Disobedient]:
        wrapped: list[Disobedient] = []

        def wrap(controller: Any) -> Disobedient:
            wrapped.append(Disobedient(controller, fault))
            return wrapped[0]

        def trip() -> None:
            wrapped[0].begin()
            raise Tripped("test", "a test trips", 0.0)

        change_instrument(monkeypatch, "controller", wrap)
        at_row(monkeypatch, 100, trip)
        return wrapped

    return make


@pytest.mark.parametrize("fault", ["silent", "replies lost"])
def test_what_is_not_confirmed_ends_with_11_and_nobody_says_confirmed(
    peltier: Peltier, tmp_path: Path, disobeys: Callable[[str], list[Disobedient]], fault: str
) -> None:
    wrapped = disobeys(fault)
    status, out, err = peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert status == 11
    assert "OUTPUT NOT CONFIRMED OFF" in err
    first, *more = err.splitlines()[-2:]
    assert "Switch the controller off by hand" in first
    assert more == [f"peltier run: what was recorded is in {tmp_path / 'run.part'}, and `peltier report` draws it"]
    assert "a test trips" in err
    assert "confirmed by the controller" not in out + err
    assert wrapped[0].output_A == 0.0  # its dead man, or the off that it heard
    document = json.loads((tmp_path / "run.part" / "run.json").read_text())
    assert document["stop"]["output_off_confirmed"] is False


def test_a_controller_that_is_deaf_is_off_by_its_dead_man_and_that_is_told(
    peltier: Peltier, tmp_path: Path, disobeys: Callable[[str], list[Disobedient]]
) -> None:
    wrapped = disobeys("deaf to all")
    status, _, err = peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert wrapped[0].output_A == 0.0
    assert status == 10
    assert "its own dead man switched the output off" in err
    assert "its status, and the current that it measures" in err


@pytest.mark.parametrize("verb", ["run", "calibrate"])
def test_nobody_would_switch_off(peltier: Peltier, tmp_path: Path, verb: str) -> None:
    """Real ports, no guard (the verb is called from inside Python), and a controller without a dead man."""
    path = write_bench(tmp_path, controller="/dev/ttyNOPE7", meter="/dev/ttyNOPE8", time="real")
    refused = "if the program hangs, the output stays on"
    assert refused not in peltier(verb, path, "--out", tmp_path / "run")[2]
    path.write_text(path.read_text().replace('driver = "meerstetter"', 'driver = "srs_ldc500"'))
    err = peltier.fails(verb, path, "--out", tmp_path / "run")
    assert refused in err
    assert len(err.splitlines()) == 1
    _, _, err = peltier(verb, path, "--out", tmp_path / "run", "--unguarded")
    assert refused not in err
    assert "/dev/ttyNOPE7" in err


def test_check_clears_an_error_if_told(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    change_instrument(monkeypatch, "controller", lambda one: one.trip(104) or one)
    path = write_bench(tmp_path)
    status, out, _ = peltier("check", path)  # nobody is there to be asked
    assert status == 1
    assert "error 104: over-voltage at its output" in out
    assert "what to do: check the element" in out
    assert "cleared" not in out
    out = peltier.succeeds("check", path, "--clear")
    assert "cleared; status: ready" in out
