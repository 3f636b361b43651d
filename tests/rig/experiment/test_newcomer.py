"""What a newcomer at a bench stumbles over first: each is told in one line, with what to look at."""

from __future__ import annotations

import io
import math
import threading
from pathlib import Path
from typing import Any, cast

import pytest

from rig.bench.assembly import emulated_instruments
from rig.command.terminal import Progress
from rig.config.configuration import read_configuration
from rig.config.model_file import read_model
from rig.config.target import parse_profile
from rig.control.decision import Decision, Tick
from rig.core.reading import Reading
from rig.core.streams import PatientLine, TerminalLine
from rig.daemon.status_text import clock
from rig.experiment.feasibility import expected_calibration, expected_run
from rig.ports.pseudo_terminal import PseudoTerminals
from tests.peltier import Peltier
from tests.rig.drivers.far_ends import Answering, Wrapped
from tests.rig.small import write_bench


@pytest.mark.parametrize(
    ("role", "status", "asked"),
    [
        ("controller", 11, "the controller (meerstetter) was asked to switch its output off"),
        ("meter", 1, "the meter (keithley2000) was asked who it is"),
    ],
)
def test_a_port_on_which_nobody_answers(tmp_path: Path, peltier: Peltier, role: str, status: int, asked: str) -> None:
    path = write_bench(tmp_path)
    instruments = {name: i for name, _, i in emulated_instruments(read_configuration(path), 0.0)}
    instruments[role] = cast(Any, Answering())
    with PseudoTerminals(instruments) as terminals:
        ports = terminals.paths
        path = write_bench(tmp_path, time="real", controller=ports["controller"], meter=ports["meter"])
        found, _, err = peltier("run", path, "--out", tmp_path / "run")
    assert found == status
    assert len(err.strip().splitlines()) == 1
    for text in (ports[role], "nobody answers there", asked, "peltier ports --ask", f"bench.{role}: driver, baud"):
        assert text in err
    assert ("output off, confirmed" in err) == (role == "meter")


def test_check_says_that_the_ports_are_swapped(tmp_path: Path, peltier: Peltier) -> None:
    """Two adapters of a kind change their names with the order in which they are plugged in."""
    path = write_bench(tmp_path)
    with PseudoTerminals({n: i for n, _, i in emulated_instruments(read_configuration(path), 0.0)}) as terminals:
        ports = terminals.paths
        path = write_bench(tmp_path, time="real", controller=ports["meter"], meter=ports["controller"])
        status, _, err = peltier("check", path)
    assert status == 2
    lines = [line for line in err.splitlines() if line.startswith(str(path))]
    assert len(lines) == 3
    assert ports["meter"] in lines[0]
    assert "there answers Keithley 2000" in lines[0]
    assert "there answers Meerstetter" in lines[1]
    assert "they are swapped; exchange them. output off, confirmed by the controller" in lines[2]


def test_limits_in_kelvin_never_reach_the_controller(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path)
    for low, high, degC in ((283, 368, "[9.85, 94.85]"), (223.15, 473.15, "[-50, 200]")):
        path.write_text(path.read_text().replace("[10, 95]", f"[{low}, {high}]"))
        err = peltier.fails("check", path)
        assert f"limits.temperature_degC: [{low}, {high}]: expected degC" in err
        assert f"in kelvin this would be {degC}" in err
        path = write_bench(tmp_path)


class ByCarriageReturn(Wrapped):
    """A meter whose menu has CR for its terminator."""

    def transmit(self, time_s: float) -> bytes:
        return super().transmit(time_s).replace(b"\n", b"\r")


def test_a_meter_whose_answers_have_another_end_is_told_from_a_silent_one(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path)
    instruments = {name: i for name, _, i in emulated_instruments(read_configuration(path), 0.0)}
    instruments["meter"] = cast(Any, ByCarriageReturn(instruments["meter"]))
    with PseudoTerminals(instruments) as terminals:
        ports = terminals.paths
        path = write_bench(tmp_path, time="real", controller=ports["controller"], meter=ports["meter"])
        status, _, err = peltier("run", path, "--out", tmp_path / "run")
    assert status == 1
    assert "they end in CR (its terminator)" in err
    assert "nobody" not in err


def test_a_missing_port_leaves_no_folder(tmp_path: Path, peltier: Peltier, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_bench(tmp_path, time="real", controller=str(tmp_path / "ttyUSB0"), meter=str(tmp_path / "ttyUSB1"))
    before = sorted(tmp_path.iterdir())
    err = peltier.fails("run", path, status=1)
    assert len(err.splitlines()) == 1
    assert "ttyUSB0: cannot be opened: No such file or directory" in err
    assert sorted(tmp_path.iterdir()) == before


def test_a_limit_beyond_the_device_names_both(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, changed=[("current_A = 4.0", "current_A = 40.0")])
    err = peltier.fails("check", path)
    assert len(err.strip().splitlines()) == 1
    assert "current limit 40 A: this device takes at most 4 A" in err


def test_only_the_experiment_needs_its_target_and_its_model(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, target='"later.csv"')
    path.write_text(path.read_text().replace('kind = "track_resistance"\nmodel = "model.toml"',
                                             'kind = "track_resistance"\nmodel = "later.toml"'))  # fmt: skip
    err = peltier.fails("run", path, "--out", tmp_path / "run")
    assert [line.partition(": ")[2].partition(":")[0] for line in err.splitlines()] == [
        "experiment.model",
        "experiment.target",
    ]
    assert peltier("check", path)[0] == 0


# -- the line that tells how far it is ---------------------------------------------------------------------------


class Screen(io.StringIO):
    """A stream that is a terminal, or not; and its clock."""

    def __init__(self, terminal: bool) -> None:
        super().__init__()
        self._terminal, self.now_s = terminal, 0.0

    def isatty(self) -> bool:
        return self._terminal


def a_tick(time_s: float, phase: str) -> Tick:
    readings = Reading(61.234, time_s), Reading(12340.0, time_s)
    return Tick(time_s, phase, *readings, 1e-4, 1.25, Decision(), cast(Any, None))


def test_a_terminals_line_is_rewritten_in_place_and_cleared() -> None:
    screen = Screen(True)
    line = TerminalLine(screen, lambda: screen.now_s)
    progress = Progress(line)
    progress.expect([("condition", 60.0), ("track", 100.0)], "A", "resistance_ohm")
    for k in range(100):
        screen.now_s = 0.1 * k
        if k % 16 == 0:
            progress.phase("condition", 0.1 * k, 40.0)
        progress.tick(a_tick(0.1 * k, "condition"))
    shown = screen.getvalue().split("\r")[1:]
    assert 30 < len(shown) <= 51  # five a second at most
    assert "\n" not in screen.getvalue()
    assert shown[0].rstrip() == ("condition 0:00 of about 2:20, 2:20 to go   61.23 degC   12.34 kohm   1.25 A")
    line.clear()
    assert screen.getvalue().endswith("\r" + " " * len(shown[0]) + "\r")


def test_a_terminal_that_is_halted_holds_up_nobody() -> None:
    class Halted(Screen):
        def write(self, text: str) -> int:
            reached.set()
            go_on.wait(20.0)
            return super().write(text)

    reached, go_on, screen = threading.Event(), threading.Event(), Halted(True)
    line = PatientLine(TerminalLine(screen, lambda: screen.now_s))
    line.show("the first")
    assert reached.wait(20.0)
    for k in range(1000):  # each would wait for ever
        line.show(f"number {k}")
    assert screen.getvalue() == ""
    go_on.set()
    line.clear()
    shown = [text.strip() for text in screen.getvalue().split("\r") if text.strip()]
    assert shown[0] == "the first"
    assert len(shown) <= 2


def test_the_time_to_go_follows_the_phases_as_they_are() -> None:
    progress = Progress(TerminalLine(Screen(False)))
    progress.expect([("polarity", 5.0), ("pulse", 8.0), ("pulse", 8.0), ("track", 100.0)], "A", "")
    assert progress.to_go_s == 121.0
    progress.phase("polarity", 0.0, 80.0)  # at the longest
    progress.tick(a_tick(4.0, "polarity"))
    progress.phase("pulse", 0.0, 10.0)
    progress.phase("pulse", 4.0, 10.0)
    assert progress.to_go_s == 6.0 + 8.0 + 100.0
    progress.phase("pulse", 0.0, 10.0)
    progress.phase("something else", 0.0, 3.0)
    assert progress.to_go_s == 3.0 + 100.0
    progress.tick(a_tick(20.0, "track"))
    progress.tick(a_tick(1.0, "track"))  # the next law's run
    assert progress.elapsed_s == 21.0
    assert clock(3725.0) == "1:02:05"


def test_what_is_expected_is_about_what_it_takes(tmp_path: Path) -> None:
    file = read_configuration(write_bench(tmp_path))
    model = read_model(tmp_path / "model.toml")
    target = parse_profile(["start 20 kohm", "hold 50 s"], "resistance", "a test")
    phases = expected_run(file.content, target, model)
    assert [name for name, _ in phases] == ["polarity", "condition", "approach", "settle", "track"]
    assert phases[-1] == ("track", 50.0)
    assert [name for name, _ in expected_run(file.content, target, None)][:-4] == [
        name for name, _ in expected_calibration(file.content)
    ]
    assert all(math.isfinite(seconds) and seconds > 0.0 for _, seconds in expected_calibration(file.content))
