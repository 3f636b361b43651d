"""What lies beside the work, or where PYTHONPATH says, is taken for no module of Python's, of a package's or of ours.

All names at once in one folder: one that was imported has left its mark. `./peltier benchmark shadowed_names` does the
same with more verbs and more ways to start them.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.shadowed_names import environment, installed, marked, names, strew, write_work
from tests.test_launcher import launcher

OWN = Path(sys.prefix).resolve() == (Path(__file__).resolve().parents[1] / ".venv").resolve()
pytestmark = pytest.mark.skipif(not OWN or os.name == "nt", reason="runs ./peltier, whose Python is not this one")


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


@pytest.mark.parametrize("name", ["rig", "serial", "sim", "compensator", "types", "msvcrt", "mpl_toolkits"])
def test_nor_is_one_where_pythonpath_says(root: Path, tmp_path: Path, name: str) -> None:
    """An `export PYTHONPATH=~/lab` in a .bashrc reaches every program; its folder comes last."""
    write_work(tmp_path)
    marks = strew(tmp_path, [name], False)
    for path in (f"{tmp_path}", f"{tmp_path}:", "."):
        status, text = said(root / "peltier", tmp_path, "off config.toml", PYTHONPATH=path)
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


def test_modules_of_the_users_pythonpath_are_found_last(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driver of one's own may import what its maker sells."""
    (tmp_path / "makers_bath.py").write_text("name = 'bath'\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    module = launcher(root, monkeypatch)
    code = "import sys, makers_bath; print(makers_bath.name, sys.path[-1])"
    done = subprocess.run(
        [sys.executable, "-c", code], env=module.trusting(**module.VERB), capture_output=True, text=True
    )
    assert done.stdout.split() == ["bath", str(tmp_path)], done.stderr
