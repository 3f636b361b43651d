"""The wheel: what `pip install` gives somebody without a checkout.

It is built and installed into an environment of its own, without a network: the packages that it needs are those of
this Python, and compiled loops come from this checkout's cache.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from compensator.compiled import folders
from rig.config.model_file import read_model
from tests.rig.small import write_bench

ROOT = Path(__file__).resolve().parents[1]
Peltier = Callable[..., "subprocess.CompletedProcess[str]"]


def run(*command: object, folder: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """Run a command as somebody who has just logged in: with nothing of this process' paths."""
    left = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PELTIER_PYTHON"))}
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=folder, env={**left, **more}, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    built = run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", out, folder=ROOT)
    assert built.returncode == 0, built.stderr
    return next(out.glob("*.whl"))


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder that is not the checkout, with a configuration."""
    folder = tmp_path_factory.mktemp("work")
    path = write_bench(folder, target='["start 1 A", "sine 1 A period 60 s for 120 s"]')
    path.write_text(path.read_text().replace("track_resistance", "current_profile"))
    return folder


@pytest.fixture(scope="module")
def peltier(wheel: Path, work: Path, tmp_path_factory: pytest.TempPathFactory) -> Peltier:
    """The command of an environment that has the wheel."""
    home = tmp_path_factory.mktemp("installed")
    made = run(sys.executable, "-I", "-m", "venv", "--without-pip", home, folder=work)
    assert made.returncode == 0, made.stderr
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(home)}))
    (packages / "others.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    pip = [sys.executable, "-I", "-m", "pip", "--python", home / "bin" / "python"]
    installed = run(*pip, "install", "--no-index", "--no-deps", "--no-compile", wheel, folder=work)
    assert installed.returncode == 0, installed.stderr

    def command(*words: object) -> subprocess.CompletedProcess[str]:
        return run(home / "bin" / "peltier", *words, folder=work, NUMBA_CACHE_DIR=str(folders()[0]))

    found = run(home / "bin" / "python", "-c", "import rig; print(rig.__file__)", folder=work)
    assert found.stdout.startswith(str(home)), "the environment imports the checkout, not the wheel"
    return command


def test_nothing_is_missing_in_the_wheel(wheel: Path) -> None:
    """A page without its script, or `init` without its templates, would be found by whoever installed it."""
    packages = [ROOT / name for name in ("compensator", "sim", "rig")]
    files = [path for package in packages for path in package.rglob("*") if path.is_file()]
    wanted = {str(path.relative_to(ROOT)) for path in files if "__pycache__" not in path.parts}
    packed = set(zipfile.ZipFile(wheel).namelist())
    assert wanted | {"peltier_command.py", "rig/templates/demo.toml"} <= packed
    assert not [name for name in packed if name.startswith(("tests/", "benchmarks/", "docs/"))]


def test_the_installed_command_does_what_a_checkout_does(peltier: Peltier, work: Path) -> None:
    """Somebody who installs the wheel types what the README says, in a folder of theirs."""
    helped = peltier("--help")
    assert (helped.returncode, helped.stderr) == (0, "")
    assert all(verb in helped.stdout for verb in ("calibrate", "diagnose", "serve"))
    began = peltier("init", "my_rig")
    assert began.returncode == 0, began.stderr
    names = {Path(line).name for line in began.stdout.splitlines()}
    assert names == {"demo.toml", "heater.toml", "rig.toml", "simulated.toml"}
    simulated = peltier("simulate", "config.toml", "--out", "record.csv")
    assert simulated.returncode == 0, simulated.stderr
    identified = peltier(
        "identify", "record.csv", "--out", "film.toml", "--kind", "extended_generalized_pi", "--json", "-"
    )
    assert identified.returncode == 0, identified.stderr
    assert json.loads(identified.stdout)["film"]
    read_model(work / "film.toml")
