"""As on Windows: without the modules that only POSIX has, without fork and without Unix sockets.

Each verb runs in a process in which these cannot be imported. pyserial, which chooses its own by the system's name, is
loaded before: what is tested is that nothing of ours asks for them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.rig.small import write_bench

BLOCKED = """
import importlib.abc, os, signal, socket, subprocess, sys
import serial, serial.tools.list_ports
gone = {"fcntl", "termios", "pty", "tty", "resource", "grp", "pwd", "syslog", "crypt", "readline"}
for name in gone:
    sys.modules.pop(name, None)
class Blocked(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in gone:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocked())
for name in ("fork", "getuid", "geteuid", "setsid", "posix_fallocate", "pwrite", "set_blocking", "mkfifo", "nice"):
    delattr(os, name)
for name in ("SIGHUP", "SIGQUIT", "SIGCHLD", "SIGTSTP", "SIGKILL"):
    delattr(signal, name)
del socket.AF_UNIX
from rig.__main__ import main
"""
EACH = """
import contextlib, io, json
answers = []
for words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(words)
    answers.append([status, out.getvalue(), err.getvalue()])
print(json.dumps(answers))
"""
COLD = """
import sim.inference.film.fit, sim.diagnosis.diagnose, rig.experiment.sweep, rig.guard.process, rig.report.run
import rig.command.experiments, rig.command.records, rig.command.many, rig.command.bench
import rig.experiment.tuning, rig.report.tuning
"""


def python(root: Path, folder: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """A program in a process that lacks what Windows lacks."""
    command = [sys.executable, "-c", BLOCKED + code, *words]
    environment = {**os.environ, "PYTHONPATH": str(root), "PELTIER_SOCKET": str(folder / "none.sock")}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200)


def told(root: Path, folder: Path, *commands: str) -> list[tuple[int, str, str]]:
    """(exit status, stdout, stderr) of each command line."""
    done = python(root, folder, EACH, json.dumps([command.split() for command in commands]))
    assert done.returncode == 0, done.stderr
    return [(status, out, err) for status, out, err in json.loads(done.stdout)]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a configuration, its model and a target file."""
    folder = tmp_path_factory.mktemp("elsewhere")
    write_bench(folder, target='["start 20 kohm", "hold 2 s", "ramp to 10 kohm in 6 s"]')
    (folder / "target.csv").write_text("time_s,target_ohm\n0,20000\n10,10000\n")
    return folder


def test_what_needs_nothing_of_posix_works(bench: Path, root: Path) -> None:
    commands = (
        "run config.toml --out run",
        "report run",
        "replay run",
        "predict model.toml run/record.csv",
        "init fresh",
        "check config.toml",
        "ports",
        "invert model.toml target.csv --out inverted.csv",
        "simulate config.toml --out simulated.csv",
        "off config.toml",
    )
    for command, (status, _, err) in zip(commands, told(root, bench, *commands), strict=True):
        assert (status, "Traceback" in err) == (0, False), f"{command}: {err}"


@pytest.mark.long
def test_tune_needs_nothing_of_posix_either(bench: Path, root: Path) -> None:
    ((status, _, err),) = told(root, bench, "tune config.toml")
    assert (status, "Traceback" in err) == (0, False), err


@pytest.mark.long
def test_the_rest_can_be_loaded(bench: Path, root: Path) -> None:
    """identify, diagnose, calibrate, sweep, tune: they take long, so what they import is all that is asked."""
    done = python(root, bench, COLD)
    assert done.returncode == 0, done.stderr


def test_what_cannot_work_says_so_in_a_line(bench: Path, root: Path) -> None:
    expected = {
        "serve config.toml": (2, "peltier serve: needs a guard process, Unix sockets and file locks"),
        "emulate config.toml": (2, "peltier emulate: needs pseudo-terminals"),
        "status": (1, "no daemon runs here"),
        "stop": (1, "no daemon runs here"),
        "reset --reason none": (1, "no daemon runs here"),
        "watch": (1, "no daemon runs here"),
    }
    for command, (status, out, err) in zip(expected, told(root, bench, *expected), strict=True):
        wanted, says = expected[command]
        assert (status, out) == (wanted, ""), command
        assert says in err
        assert len(err.strip().splitlines()) == 1


def test_real_ports_without_a_guard_are_told_in_a_line(root: Path, tmp_path: Path) -> None:
    path = write_bench(tmp_path, time="real", controller="COM3", meter="COM4")
    done = python(root, tmp_path, "sys.exit(main())", "run", str(path), "--out", "run")
    assert done.returncode == 1
    assert done.stderr.count("no guard process here") == 1
    assert "COM3: cannot be opened" in done.stderr
    assert "Traceback" not in done.stderr
