"""The verbs that talk to a daemon, a daemon as a process of its own under its guard, and every way that it ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.daemon.client import Client
from rig.ports.pseudo_terminal import PseudoTerminals
from tests.peltier import Peltier, begun
from tests.rig.daemon.benches import environment, put_on, until, write_current

STARTS_S = 200.0  # of patience on a busy computer


@dataclass
class Daemon:
    """A daemon's process, what it is told by systemd's socket, and its instruments."""

    process: subprocess.Popen[str]
    folder: Path
    path: Path
    instruments: dict[str, Any]
    notified: socket.socket

    def ask(self, method: str, path: str, /, **body: Any) -> Any:
        with Client(self.folder / "bench.sock") as client:
            return client.ask(method, path, **body)

    def until(self, word: str) -> dict[str, Any]:
        """Wait for a state."""
        return until(lambda: s if (s := self.ask("GET", "/api/state"))["state"] == word else None, word)


@contextlib.contextmanager
def started(folder: Path) -> Iterator[Daemon]:
    """A daemon that is ready, until the end of the block."""
    path = write_current(folder, '["start 0 A", "hold 0.5 s"]')
    emulated = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
    with PseudoTerminals(emulated) as terminals, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notified:
        notified.bind(str(folder / "notify"))
        notified.settimeout(STARTS_S)
        put_on(path, terminals.paths, "idle_period_s = 0.2\n")
        process = begun("serve", path, stderr=subprocess.STDOUT, env=environment(folder))
        try:
            assert notified.recv(4096).startswith(b"READY=1")
            yield Daemon(process, folder, path, emulated, notified)
        finally:
            process.terminate()
            process.wait(STARTS_S)
            assert process.stdout is not None
            process.stdout.close()


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with started(tmp_path_factory.mktemp("daemon")) as one:
        yield one


@pytest.fixture
def here(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> Daemon:
    """The daemon, found by the verbs of this process."""
    monkeypatch.setenv("PELTIER_SOCKET", str(daemon.folder / "bench.sock"))
    return daemon


@pytest.fixture
def ending(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    """A daemon that no other test needs: it may be ended."""
    with started(tmp_path_factory.mktemp("ending")) as one:
        monkeypatch.setenv("PELTIER_SOCKET", str(one.folder / "bench.sock"))
        yield one


def test_status_as_text_and_as_json(here: Daemon, peltier: Peltier) -> None:
    here.until("idle")
    out = peltier.quietly("status")
    assert "output         off, confirmed by the controller" in out
    status, out, err = peltier("status", "--json", "-")
    assert status == 0
    assert json.loads(out)["state"] == "idle"
    assert "temperature" in err


def test_watch_tells_a_line_a_second(here: Daemon, peltier: Peltier) -> None:
    out = peltier.quietly("watch", "--seconds", "0.5")
    assert "idle" in out
    assert "degC" in out


def test_the_watchdog_is_fed(here: Daemon) -> None:
    until(lambda: here.notified.recv(4096) == b"WATCHDOG=1", "a cycle")


def test_run_is_handed_over_and_followed(here: Daemon, peltier: Peltier, tmp_path: Path) -> None:
    result = tmp_path / "result.json"
    out = peltier.quietly("run", here.path, "--out", tmp_path / "out", "--json", result)
    assert "handed over to the daemon bench" in out
    assert f"report: {tmp_path / 'out' / 'report.html'}" in out
    assert (tmp_path / "out" / "record.csv").is_file()
    assert json.loads(result.read_text())["folder"] == str(tmp_path / "out")
    assert here.until("idle")["output"] == "off"


def test_what_is_wrong_comes_back_from_the_daemon(here: Daemon, peltier: Peltier, tmp_path: Path) -> None:
    wide = tmp_path / "wide.toml"
    wide.write_text(here.path.read_text().replace("current_A = 4.0", "current_A = 6.0"))
    (tmp_path / "model.toml").write_text((here.path.parent / "model.toml").read_text())
    assert "limits.current_A: 6: expected at most the bench's, 4" in peltier.fails("run", wide)


def long_run(here: Daemon, tmp_path: Path, name: str = "long", begins: bool = True) -> subprocess.Popen[str]:
    path = here.path.with_name("long.toml")
    path.write_text(here.path.read_text().replace("hold 0.5 s", "hold 300 s").replace("start 0 A", "start 1 A"))
    words = ("run", path, "--out", tmp_path / name)
    process = begun(*words, stderr=subprocess.STDOUT, env=environment(here.folder))
    if not begins:
        return process
    until(lambda: (here.ask("GET", "/api/state")["job"] or {}).get("phase") == "profile", "the job")
    until(lambda: output_is_on(here), "the output coming on")
    return process


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    text, _ = process.communicate(timeout=STARTS_S)
    return process.returncode, text


def test_ctrl_c_of_the_run_that_was_handed_over_ends_its_job(here: Daemon, tmp_path: Path) -> None:
    process = long_run(here, tmp_path)
    process.send_signal(signal.SIGINT)
    status, text = ended(process)
    assert status == 130
    assert "output off, confirmed" in text
    assert here.until("idle")["output"] == "off"


def test_a_calibration_is_handed_over_too(here: Daemon, tmp_path: Path) -> None:
    words = ("calibrate", here.path, "--out", tmp_path / "out")
    process = begun(*words, stderr=subprocess.STDOUT, env=environment(here.folder))
    until(lambda: (here.ask("GET", "/api/state")["job"] or {}).get("phase") not in (None, "working"), "the loop")
    assert here.ask("GET", "/api/jobs")[0]["kind"] == "calibration"
    process.send_signal(signal.SIGINT)
    status, text = ended(process)
    assert status == 130, text
    assert "handed over to the daemon bench" in text
    assert "output off, confirmed" in text
    assert (tmp_path / "out.part" / "record.csv").is_file()


def test_stop_and_reset(here: Daemon, peltier: Peltier, tmp_path: Path) -> None:
    process = long_run(here, tmp_path)
    assert output_is_on(here)
    out = peltier.quietly("stop", "--json", tmp_path / "stop.json")
    assert "output off, confirmed by the controller in" in out
    assert json.loads((tmp_path / "stop.json").read_text())["confirmed"] is True
    assert not output_is_on(here)
    status, text = ended(process)
    assert status == 1
    assert "stopped by peltier stop; output off, confirmed by the controller" in text
    process = long_run(here, tmp_path, "later", begins=False)
    until(lambda: here.ask("GET", "/api/state")["queue"], "a job that waits")
    assert peltier("reset", "--reason", "")[0] == 2
    assert peltier("reset", "--reason", "a test")[0] == 0
    until(lambda: output_is_on(here), "its beginning")
    assert peltier("stop")[0] == 0
    assert "the bench is stopped (stopped by peltier stop): the job waits; once" in (said := ended(process)[1])
    assert "`peltier reset --reason TEXT`" in said
    assert peltier("reset", "--reason", "a test")[0] == 0
    assert "nothing is latched" in peltier.fails("reset", "--reason", "a test", status=1)


def test_off_by_the_daemon(here: Daemon, peltier: Peltier) -> None:
    for words in (["off"], ["off", here.path]):
        assert "bench: output off, confirmed" in peltier.quietly(*words)
    assert peltier("reset", "--reason", "a test")[0] == 0


def test_a_second_daemon(here: Daemon, peltier: Peltier, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    by = f"held by process {here.ask('GET', '/daemon')['pid']}"
    status, _, err = peltier("serve", here.path)  # the same name
    assert status == 75
    assert by in err
    monkeypatch.setenv("PELTIER_SOCKET", str(tmp_path / "other.sock"))
    status, _, err = peltier("serve", here.path)  # the same history
    assert status == 75
    assert by in err
    text = here.path.read_text().replace('folder = "kept"', f'folder = "{tmp_path}"')
    other = here.path.with_name("other.toml")
    other.write_text(text)
    status, _, err = peltier("serve", other)  # the same ports
    assert status == 75
    assert by in err
    assert here.ask("GET", "/api/state")["state"] == "idle"


def output_is_on(here: Daemon) -> bool:
    return bool(here.instruments["controller"].status == 2)  # "run"


def test_a_bench_process_that_is_killed_leaves_the_output_off(ending: Daemon, peltier: Peltier, tmp_path: Path) -> None:
    process = long_run(ending, tmp_path)
    assert output_is_on(ending)
    os.kill(ending.ask("GET", "/daemon")["pid"], signal.SIGKILL)
    until(lambda: not output_is_on(ending), "the output going off")
    status, text = ended(process)
    assert status == 1, text
    assert "its guard: process" in text
    assert "output off, confirmed by the controller" in text
    ending.process.wait(STARTS_S)
    assert ending.process.returncode == 128 + signal.SIGKILL
    assert "no daemon runs here" in peltier.fails("status", status=1)
    assert peltier("stop")[0] == 1
    status, out, _ = peltier("off", ending.path)  # and with no daemon the port is opened
    assert status == 0
    assert "output off, confirmed by the controller" in out
    assert "name the CONFIG" in peltier.fails("off")


def test_sigterm_ends_it_with_the_output_off(ending: Daemon) -> None:
    """One that began where another had been killed."""
    os.kill(ending.ask("GET", "/daemon")["pid"], signal.SIGKILL)
    ending.process.wait(STARTS_S)
    again = begun("serve", ending.path, stderr=subprocess.STDOUT, env=environment(ending.folder))
    try:
        while not ending.notified.recv(4096).startswith(b"READY"):
            pass
    finally:
        again.terminate()
        status, text = ended(again)
    told = until(lambda: s if (s := ending.notified.recv(4096)).startswith(b"EXTEND") else None, "how long it may take")
    assert told == b"EXTEND_TIMEOUT_USEC=30000000"  # its dead man's 5 s
    assert status == 128 + signal.SIGTERM
    assert "output off, confirmed by the controller" in text
    assert not (ending.folder / "bench.sock").exists()


@pytest.mark.parametrize("words", [["stop"], ["off"], ["status"], ["reset", "--reason", "x"]])
def test_verbs_that_must_not_wait_import_little(tmp_path: Path, words: list[str]) -> None:
    code = (
        f"import sys; before = set(sys.modules); import rig.__main__ as m; m.main({words!r});"
        "heavy = {'numpy', 'rich', 'pydantic', 'serial', 'starlette', 'asyncio', 'sqlite3'} & set(sys.modules);"
        "heavy |= {'typing', 'pathlib', 'inspect', 'shutil', 'threading'} & set(sys.modules) - before;"
        "sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment(tmp_path))
    assert done.returncode == 0, done.stderr
