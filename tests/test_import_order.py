"""What lies beside the work, or where PYTHONPATH says, is taken for no module of Python's, of a package's or of ours.

All names at once in one folder: one that was imported has left its mark.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tests.rig.small import write_bench
from tests.test_launcher import launcher

ROOT = Path(__file__).resolve().parent.parent
OURS = ("rig", "sim", "compensator")
SITE = ("sitecustomize", "usercustomize")
COMMAND = "import re\nimport sys\nfrom peltier_command import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
OWN = Path(sys.prefix).resolve() == (ROOT / ".venv").resolve()
pytestmark = pytest.mark.skipif(not OWN or os.name == "nt", reason="runs ./peltier, whose Python is not this one")


def names() -> list[str]:
    """Return the names of modules that a file beside the work could have, in order."""
    found = {*sys.stdlib_module_names, *packages_distributions(), *OURS, *SITE, "pip", "pyvisa", "yaml", "__main__"}
    return sorted(name for name in found if name.isidentifier())


def strew(folder: Path, names: Sequence[str], as_folders: bool) -> Path:
    """Write a module of each name, which leaves its name in the file of marks when it is imported; the file's path."""
    marks = folder / "marks"
    for name in names:
        path = folder / name / "__init__.py" if as_folders else folder / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"with open({str(marks)!r}, 'a') as file:\n    file.write('{name}\\n')\n")
        if as_folders:
            shutil.copyfile(path, path.parent / "__main__.py")
    return marks


def marked(marks: Path) -> list[str]:
    """Return what was imported since the last call."""
    found = sorted(set(marks.read_text().split())) if marks.exists() else []
    marks.unlink(missing_ok=True)
    return found


def installed(folder: Path) -> Path:
    """Make an environment with the packages of this Python in which `peltier` is installed; the command's path."""
    subprocess.run([sys.executable, "-I", "-m", "venv", "--without-pip", str(folder)], check=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    for name in (*OURS, "peltier_command.py"):
        (packages / name).symlink_to(ROOT / name)
    (packages / "others.pth").write_text(sysconfig.get_path("purelib"))
    command = folder / "bin" / "peltier"
    command.write_text(f"#!{folder / 'bin' / 'python'}\n{COMMAND}")
    command.chmod(0o755)
    return command


def environment(folder: Path, **more: str) -> dict[str, str]:
    """Of a user who has just logged in: nothing of this process' path, and a daemon's socket of its own."""
    left = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PELTIER_PYTHON"))}
    return {**left, "PELTIER_SOCKET": str(folder / "bench.sock"), **more}


def write_work(folder: Path) -> None:
    """Write configurations: of a rig that is not there, and of a simulated one."""
    path = write_bench(folder, target='["start 20 kohm", "hold 1 s"]')
    text = path.read_text()
    write_bench(folder, controller=str(folder / "no_port"), time="real")
    path.rename(folder / "away.toml")
    path.write_text(text)


def said(command: Path, folder: Path, words: str, **more: str) -> tuple[int, str]:
    """Exit status and what it said on both streams."""
    done = subprocess.run(
        [command, *words.split()], cwd=folder, env=environment(folder, **more), capture_output=True, text=True
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("as_folders", [False, True], ids=["files", "folders"])
def test_no_name_beside_the_work_is_imported(root: Path, tmp_path: Path, as_folders: bool) -> None:
    """Whoever has a `serial.py` beside the work would find `peltier off` broken, and the heater on."""
    write_work(tmp_path)
    marks = strew(tmp_path, names(), as_folders)
    asked = {"stop": 1, "off config.toml": 0, "off away.toml": 11}
    if not as_folders:
        asked["run config.toml --out run"] = 0
    for words, status in asked.items():
        ended, text = said(root / "peltier", tmp_path, words)
        assert (ended, "Traceback" in text) == (status, False), text
        assert marked(marks) == []


@pytest.mark.parametrize("path", ["{}:", "."])
def test_nor_is_one_where_pythonpath_says(root: Path, tmp_path: Path, path: str) -> None:
    """An `export PYTHONPATH=~/lab` in a .bashrc reaches every program; its folder comes last."""
    write_work(tmp_path)
    marks = strew(tmp_path, ["rig", "serial", "types", "mpl_toolkits"], False)
    status, text = said(root / "peltier", tmp_path, "off config.toml", PYTHONPATH=path.format(tmp_path))
    assert (status, marked(marks)) == (0, []), text


SPAWNS = """
import sys
if __name__ == "__main__":
    import peltier_command
    sys.argv = ["peltier", "off", "config.toml"]
    status = peltier_command.main()
    import multiprocessing
    child = multiprocessing.get_context("spawn").Process(target=print)
    child.start()
    child.join()
    sys.exit(status or child.exitcode)
"""


def test_the_installed_command_imports_none_either(tmp_path: Path) -> None:
    """Nor do the processes that it starts, which would look in the working folder first."""
    command = installed(tmp_path / "installed")
    work, away = tmp_path / "work", tmp_path / "away"
    work.mkdir()
    away.mkdir()
    write_work(work)
    of_the_work = strew(work, names(), False)
    on_the_path = strew(away, ["rig", "compensator", "serial", "numpy", "argparse", "importlib", "tempfile"], False)
    for words, status in {"stop": 1, "off config.toml": 0}.items():
        ended, text = said(command, work, words, PYTHONPATH=str(away))
        assert (ended, marked(of_the_work), marked(on_the_path)) == (status, [], []), text
    script = command.parent / "spawns.py"
    script.write_text(SPAWNS)
    for path in ("", str(away)):
        more = environment(work, PYTHONPATH=path)
        done = subprocess.run([command.parent / "python", script], cwd=work, env=more, capture_output=True, text=True)
        assert (done.returncode, marked(of_the_work), marked(on_the_path)) == (0, [], []), done.stderr


def test_a_script_imports_its_own_modules_and_our_rig(root: Path, tmp_path: Path) -> None:
    """`./peltier python` is for scripts: their modules are found, but none in the place of an installed one."""
    script = "import helper, rig, serial\nprint(helper.answer, rig.__name__, serial.Serial)\n"
    (tmp_path / "evening.py").write_text(script)
    (tmp_path / "helper.py").write_text("answer = 42\n")
    for name in ("rig", "serial"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong one')\n")
    status, text = said(root / "peltier", tmp_path, "python evening.py")
    assert status == 0, text
    assert "42 rig <class 'serial" in text
    assert f"peltier: {tmp_path / 'serial.py'} is not imported: 'serial' is the module" in text


def test_the_users_pythonpath_is_looked_at_last(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver of one's own may import what its maker sells."""
    (tmp_path / "makers_bath.py").write_text("name = 'bath'\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    module = launcher(root, monkeypatch)
    code = "import sys, makers_bath; print(makers_bath.name, sys.path[-1])"
    done = subprocess.run(
        [sys.executable, "-c", code], env=module.trusting(**module.VERB), capture_output=True, text=True
    )
    assert done.stdout.split() == ["bath", str(tmp_path)], done.stderr
