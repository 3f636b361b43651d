"""What `./peltier` makes of its environment, and what becomes of a set-up that is interrupted.

The set-ups are real, in a copy of the launcher, but for the installer: a small script in the place of uv, which may
hang in the middle of a package.
"""

from __future__ import annotations

import ast
import importlib
import importlib.machinery
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

INSTALLER = """#!/bin/sh
echo "$1" >> {calls}
for last; do :; done
case "$1" in
venv) exec {python} -I -m venv --without-pip "$last" ;;
pip)
    if [ -e {no_network} ]; then exit 1; fi
    if [ -e {hang} ]; then touch {venv}/lib/half_a_package; exec sleep 60; fi
    touch {venv}/lib/half_a_package
    sleep 0.2
    rm {venv}/lib/half_a_package ;;
esac
"""


def launcher(root: Path, monkeypatch: pytest.MonkeyPatch, *words: str) -> ModuleType:
    """`./peltier WORDS` as a module, before it has done anything but look at the words."""
    monkeypatch.setattr("sys.argv", ["peltier", *words])
    loader = importlib.machinery.SourceFileLoader("launcher", str(root / "peltier"))
    spec = importlib.util.spec_from_loader("launcher", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def test_who_wants_no_bytecode_beside_sources_gets_it_elsewhere(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled again in each process, a run's modules would take a second and a half."""
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.delenv("PYTHONPYCACHEPREFIX", raising=False)
    launcher(root, monkeypatch)
    assert "PYTHONDONTWRITEBYTECODE" not in os.environ
    assert os.environ["PYTHONPYCACHEPREFIX"] == str(root / ".venv" / "bytecode")
    monkeypatch.delenv("PYTHONPYCACHEPREFIX")


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (("python", "evening.py", "--fast"), ["evening.py", "--fast"]),
        (("python",), []),
        (("run", "rig.toml"), ["-m", "rig", "run", "rig.toml"]),
    ],
)
def test_python_is_the_one_that_the_verbs_have(
    root: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], asked: list[str]
) -> None:
    """With the packages, and the checkout on its path."""
    began: list[tuple[str, list[str], dict[str, str]]] = []
    module = launcher(root, monkeypatch, *words)
    monkeypatch.setattr(module, "set_up", lambda kind: None)
    monkeypatch.setattr(module.os, "execve", lambda path, line, environment: began.append((path, line, environment)))
    module.main()
    (path, line, environment) = began[0]
    assert (path, line) == (str(module.PYTHON), [str(module.PYTHON), *asked])
    assert environment["PYTHONPATH"] == str(root / "rig" / "launch")
    assert ("PYTHONSAFEPATH" in environment) == (words[0] != "python")  # a script has modules of its own


def test_what_is_compiled_in_the_background_is_there(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It says nothing where it fails: whoever has just set up would wait a minute in each of the first commands."""
    module = launcher(root, monkeypatch)
    wanted = [node for node in ast.parse(module.THE_LOOPS).body if isinstance(node, ast.ImportFrom)]
    assert len(wanted) == 2
    for node in wanted:
        assert callable(getattr(importlib.import_module(str(node.module)), node.names[0].name))


class Checkout:
    """A copy of the launcher with an installer that installs nothing."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.folder, self.venv = folder, folder / ".venv"
        self._calls, self._hang, self.no_network = folder / "calls", folder / "hang", folder / "no_network"
        shutil.copy(root / "peltier", folder)
        for name in ("rig", "sim", "compensator"):
            (folder / name).symlink_to(root / name)
        (folder / "requirements").mkdir()
        for kind in ("run", "dev"):
            (folder / "requirements" / f"{kind}.txt").write_text(f"# {kind}\n")
        (folder / "away.toml").write_text('[bench.controller]\ndriver = "meerstetter"\nport = "/dev/no_such_port"\n')
        uv = folder / "bin" / "uv"
        uv.parent.mkdir()
        places = {"calls": self._calls, "hang": self._hang, "no_network": self.no_network, "venv": self.venv}
        uv.write_text(INSTALLER.format(python=getattr(sys, "_base_executable", sys.executable), **places))
        uv.chmod(0o755)
        self.python3 = folder / "bin" / "python3"
        self.python3.symlink_to(getattr(sys, "_base_executable", sys.executable))

    def begin(self, *words: str) -> subprocess.Popen[str]:
        """The launcher, as a process group of its own."""
        ours = ("PYTHON", "PELTIER", "NUMBA")
        left = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
        more = {"PATH": f"{self.folder / 'bin'}:/usr/bin:/bin", "PELTIER_SOCKET": str(self.folder / "none.sock")}
        return subprocess.Popen(
            [str(self.folder / "peltier"), *words],
            cwd=self.folder,
            env={**left, **more},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def called(self) -> list[str]:
        """What the installer was asked for since the last call."""
        calls = self._calls.read_text().split() if self._calls.exists() else []
        self._calls.unlink(missing_ok=True)
        return calls

    def comes_up(self) -> bool:
        """Whether the Python of a whole .venv answers."""
        process = self.begin("python", "-c", "import sys; print(sys.prefix)")
        out, err = process.communicate()
        assert process.returncode == 0, err
        return out.strip() == str(self.venv) and not (self.venv / "lib" / "half_a_package").exists()

    def interrupted(self, end: Callable[[subprocess.Popen[str]], None]) -> tuple[int, str]:
        """A set-up that is ended in the middle of a package; its exit status, and what it said."""
        self._hang.touch()
        process = self.begin("--version")
        while not (self.venv / "lib" / "half_a_package").exists():
            assert process.poll() is None
            time.sleep(0.01)
        self._hang.unlink()
        end(process)
        _, err = process.communicate()
        return process.returncode, err

    def ended(self, *words: str) -> tuple[int, str]:
        process = self.begin(*words)
        _, err = process.communicate()
        return process.returncode, err

    def off(self) -> tuple[int, str]:
        return self.ended("off", "away.toml")


@pytest.fixture
def checkout(root: Path, tmp_path: Path) -> Checkout:
    if os.name == "nt":
        pytest.skip("the installer is a shell's script")
    return Checkout(root, tmp_path)


def kill_all(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGKILL)


def ctrl_c(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGINT)


def remove_stamp(venv: Path) -> None:
    (venv / ".stamp").unlink()


def remove_python(venv: Path) -> None:
    """As an upgrade of the system does: a link that ends nowhere."""
    (venv / "bin" / "python").unlink()
    (venv / "bin" / "python").symlink_to("/usr/bin/python3.no_more")


def replace_python(venv: Path) -> None:
    """As an upgrade that leaves a Python of another version there, which knows none of the packages."""
    version = next(venv.glob("lib/python3.*"))
    version.rename(version.parent / "python3.0")
    os.utime(venv / ".stamp")
    (venv / ".stamp").write_text((venv / ".stamp").read_text() + "0")


@pytest.mark.parametrize(("end", "status"), [(kill_all, -signal.SIGKILL), (ctrl_c, 130)])
def test_an_interrupted_set_up(checkout: Checkout, end: Callable[[subprocess.Popen[str]], None], status: int) -> None:
    """What an installer has left half done looks installed to the next one: each command failed until .venv was deleted
    by hand. Until it is whole, `off` says at once that it switched nothing off."""
    ended, err = checkout.interrupted(end)
    assert (ended, "Traceback" in err) == (status, False), err
    status, err = checkout.off()
    assert (status, err.count("\n")) == (11, 1)
    assert "OUTPUT NOT CONFIRMED OFF" in err
    assert "Switch the controller off by hand" in err
    assert checkout.comes_up()
    assert checkout.called() == ["venv", "pip", "venv", "pip"]


def test_an_installer_that_has_outlived_its_launcher_is_waited_for(checkout: Checkout) -> None:
    """Two of them in one folder would leave packages of both."""
    processes: list[subprocess.Popen[str]] = []

    def kill_the_launcher(process: subprocess.Popen[str]) -> None:
        process.kill()
        processes.append(checkout.begin("--version"))
        assert processes[0].stderr is not None
        assert "waiting" in processes[0].stderr.readline()
        os.killpg(process.pid, signal.SIGKILL)

    checkout.interrupted(kill_the_launcher)
    processes[0].communicate()
    assert processes[0].returncode == 0
    assert checkout.called() == ["venv", "pip", "venv", "pip"]


@pytest.mark.parametrize("spoil", [remove_stamp, remove_python, replace_python])
def test_an_environment_that_is_not_whole_is_made_anew(checkout: Checkout, spoil: Callable[[Path], None]) -> None:
    """An upgrade of the system's Python left an environment that no command could use, or mend."""
    assert checkout.comes_up()
    spoil(checkout.venv)
    status, err = checkout.off()
    assert (status, err.count("\n")) == (11, 1)
    assert checkout.comes_up()
    assert checkout.called() == ["venv", "pip", "venv", "pip"]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere `stat` has other options, and a second Python is begun")
def test_a_stop_does_not_wait_for_a_second_python(checkout: Checkout) -> None:
    """It was a quarter of the time until the output is off."""
    assert checkout.comes_up()
    checkout.python3.unlink()
    checkout.python3.write_text("#!/bin/sh\nexit 99\n")
    checkout.python3.chmod(0o755)
    status, _ = checkout.ended("--version")
    assert status == 99
    status, err = checkout.off()
    assert (status, err.count("\n")) == (11, 1)
    assert "OUTPUT NOT CONFIRMED OFF" in err


def test_what_is_whole_is_not_made_anew(checkout: Checkout) -> None:
    """In a laboratory without a network a security update of Python must not cost the packages."""
    assert checkout.comes_up()
    checkout.called()
    stamp = checkout.venv / ".stamp"
    lock, *made_with = stamp.read_text().split()
    stamp.write_text(f"{lock} 1 2")
    assert checkout.comes_up()
    assert (checkout.called(), stamp.read_text().split()) == ([], [lock, *made_with])
    listed = checkout.folder / "requirements" / "run.txt"
    listed.write_text("# another\n")
    checkout.no_network.touch()
    process = checkout.begin("--version")
    assert "is there a network?" in process.communicate()[1]
    assert (process.returncode, checkout.called(), stamp.exists()) == (1, ["pip"], True)
    checkout.no_network.unlink()
    assert checkout.comes_up()
    assert checkout.called() == ["pip", "pip"]  # the first only asks whether all is there


def test_two_set_ups_at_the_same_time_are_one(checkout: Checkout) -> None:
    """As when a service and a person start the program after an update."""
    both = [checkout.begin("--version") for _ in range(2)]
    heard = [process.communicate()[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], heard
    assert checkout.called() == ["venv", "pip"]
