"""Instruments that fall silent in mid run for a second or for good, take no commands, or speak garbage."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.ports.pseudo_terminal import PseudoTerminals
from tests.peltier import Peltier
from tests.rig.drivers.far_ends import Wrapped
from tests.rig.small import change_instrument, write_bench

SET_CURRENT = b"VSC351"  # parameter 50001


class Deaf(Wrapped):
    """A controller that does not hear some frames from a time on, or for a time."""

    def __init__(self, instrument: Any, begin_s: float, end_s: float, frames: bytes = b"") -> None:
        super().__init__(instrument)
        self._begin_s, self._end_s, self._frames = begin_s, end_s, frames

    def receive(self, data: bytes, time_s: float) -> None:
        if not (self._frames in data and self._begin_s <= time_s < self._end_s):
            super().receive(data, time_s)


class SpeaksGarbage(Wrapped):
    """An instrument whose answers turn into noise at a time."""

    def __init__(self, instrument: Any, begin_s: float, end_s: float) -> None:
        super().__init__(instrument)
        self._begin_s = begin_s

    def transmit(self, time_s: float) -> bytes:
        data = super().transmit(time_s)
        if time_s < self._begin_s or not data:
            return data
        return bytes((byte * 7 + 3) % 251 for byte in data) + b"\r\n"


def events(folder: Path, kind: str) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    return [line for line in lines if kind in line.values()]


def deafened(monkeypatch: pytest.MonkeyPatch, begins_s: list[float], seconds: float, frames: bytes = b"") -> None:
    def deaf(controller: Any) -> Any:
        for begin_s in begins_s:
            controller = Deaf(controller, begin_s, begin_s + seconds, frames)
        return controller

    change_instrument(monkeypatch, "controller", deaf)


@pytest.mark.parametrize("how", [Deaf, SpeaksGarbage])
def test_the_meter_dies(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path, how: type[Any]) -> None:
    change_instrument(monkeypatch, "meter", lambda meter: how(meter, 30.0, 1e9))
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=10)
    assert "no good reading of the ohmmeter" in err
    assert ("check its supply and its cable" in err) == (how is Deaf)  # one that speaks garbage has both
    assert "output off, confirmed" in err
    document = json.loads((tmp_path / "run.part" / "run.json").read_text())
    assert document["stop"]["reason"] == "ohmmeter_stale"
    assert document["stop"]["rows"] > 100


def test_a_second_of_silence_ends_no_run(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    deafened(monkeypatch, [20.0], 1.0)
    peltier.succeeds("run", write_bench(tmp_path), "--out", tmp_path / "run")
    ticks = json.loads((tmp_path / "run" / "run.json").read_text())["stop"]["ticks"]
    lost = events(tmp_path / "run", "unacknowledged")
    assert 1 <= ticks["unacknowledged"] == len(lost) <= 2
    assert "(controller, meerstetter): no answer to VSC351" in json.dumps(lost)
    assert "not acknowledged" in (tmp_path / "run" / "report.html").read_text()


def test_the_law_knows_what_is_on(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    """It took a command that had not arrived for what was on: 0.068 decades; 0.025 with that known, 0.020 in a calm."""
    deafened(monkeypatch, [57.0, 62.0, 68.0], 1.0)
    course = '["start 20 kohm", "hold 5 s", "ramp to 5 kohm at 0.1 dec/s", "ramp to 20 kohm at 0.1 dec/s", "hold 5 s"]'
    peltier.succeeds("run", write_bench(tmp_path, target=course), "--out", tmp_path / "run")
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert document["stop"]["ticks"]["unacknowledged"] == 3
    assert document["result"]["score"]["rms_dec"] < 0.04
    out = peltier.succeeds("replay", tmp_path / "run", "--json", "-")
    assert json.loads(out)["different"] == 0


def test_commands_that_nobody_takes_end_it(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    """Readings go on, so that nothing else ends it: after 2 s."""
    deafened(monkeypatch, [20.0], 1e9, SET_CURRENT)
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=1)
    assert "(controller, meerstetter): no answer to VSC351" in err
    assert "no command was acknowledged for 2." in err
    assert "expected one every 2 s" in err
    assert "check its supply" not in err  # it answers to all else
    assert "output off, confirmed" in err
    assert json.loads((tmp_path / "run.part" / "run.json").read_text())["stop"]["reason"] == "TimedOut"


def test_long_silence_names_the_instrument(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    deafened(monkeypatch, [20.0], 4.0)
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=10)
    assert "no good reading of the thermometer for 2." in err
    assert "(controller, meerstetter): no answer to ?VR03E8" in err
    assert not [line for line in events(tmp_path / "run.part", "no_reading") if line["text"].startswith("ohmmeter")]


def test_a_silent_controller_is_told_as_such(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    """Where its own dead man acts before a reading is too old, it is the commands that end the run."""
    deafened(monkeypatch, [20.0], 1e9)
    path = write_bench(tmp_path, changed=[("[bench.meter]", "dead_man_s = 1.0\n[bench.meter]")])
    err = peltier.fails("run", path, "--out", tmp_path / "run", status=11)
    said = re.search(r"expected one every 1 s; nothing has come from it for (\S+) s: check its supply", err)
    assert said is not None
    assert 1.0 <= float(said[1]) < 2.0  # and the exchange that was under way


def test_over_a_pseudo_terminal(tmp_path: Path, peltier: Peltier) -> None:
    """On a real clock; the message has the port's own name."""
    truth = tmp_path / "truth"
    truth.mkdir()
    emulated = emulated_instruments(read_configuration(write_bench(truth)), 0.0)
    instruments: dict[str, Any] = {role: one for role, _, one in emulated}
    instruments["controller"] = Deaf(instruments["controller"], 5.0, 6.0)
    current = 'kind = "current_profile"\ntarget = ["start 0.9 A", "hold 8 s"]\n'
    with PseudoTerminals(instruments) as terminals:
        path = write_bench(tmp_path, time="real", **terminals.paths)
        bench, simulation = path.read_text().split("[experiment]")[0], path.read_text().split("[simulation]")[1]
        path.write_text(f"{bench}[experiment]\n{current}period_s = 0.1\n[simulation]{simulation}")
        peltier.succeeds("run", path, "--out", tmp_path / "run")
        lost = events(tmp_path / "run", "unacknowledged")
        assert f"{terminals.paths['controller']} (controller, meerstetter): no answer to VSC351" in json.dumps(lost)
