"""What was written for the former import paths runs for one more release, with a warning at its own line."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

FORMER = {"rig.core.errors": "rig.errors", "rig.core.reading": "rig.reading", "rig.core.clock": "rig.clock"}
PAGES = {  # what docs/api listed before the packages had rooms
    "compensator.check": "check_model",
    "compensator.compress": "compress",
    "compensator.design": "design_temperature",
    "compensator.film": "FilmModel",
    "compensator.functions": "tanh_and_slope",
    "compensator.identify_film": "identify_film_records",
    "compensator.identify_plate": "identify_plate_records",
    "compensator.identify_rows": "FilmRecord",
    "compensator.inverse": "Inverse",
    "compensator.iteration": "iterate",
    "compensator.own_functions": "register_envelope",
    "compensator.pid": "PidGains",
    "compensator.plate": "PlateModel",
    "compensator.play": "play_outputs",
    "compensator.solve": "solve",
    "compensator.temperature_path": "temperature_path",
}


def printed(code: str, *options: str) -> tuple[str, str]:
    """stdout and stderr of a program of its own."""
    done = subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def own_file(root: Path, page: str) -> str:
    """The file that a page prints, with the import lines of before."""
    block = re.search(r"^```python\n(.*?)^```", (root / "docs" / page).read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert block is not None
    text = block[1]
    for now, before in FORMER.items():
        text = text.replace(f"from {now} import", f"from {before} import")
    return text


def test_a_driver_of_before(root: Path, tmp_path: Path) -> None:
    path = tmp_path / "bath.py"
    path.write_text(own_file(root, "own_driver.md"))
    assert "from rig.errors import" in path.read_text()
    code = f"from rig.drivers.registry import controller_class; print(controller_class('{path}:JulaboBath').NAME)"
    out, err = printed(code)
    assert out == "a Julabo bath\n"
    lines = path.read_text().splitlines()
    line = 1 + next(k for k, text in enumerate(lines) if text.startswith("from rig.errors import"))
    assert f"{path}:{line}: FutureWarning: rig.errors is now rig.core.errors" in err
    assert err.count("FutureWarning") == 2  # rig.errors, rig.reading


def test_its_errors_are_the_programs(root: Path) -> None:
    out, _ = printed("import rig.errors, rig.core.errors; print(rig.errors.TimedOut is rig.core.errors.TimedOut)")
    assert out == "True\n"


def test_an_effect_of_before(root: Path, tmp_path: Path) -> None:
    path = tmp_path / "plate_fin.py"
    path.write_text(own_file(root, "own_effect.md"))
    out, err = printed(f"from sim.effects.catalogue import *; print(add_effect_file(Path('{path}')).name)")
    assert (out, err) == ("plate_fin\n", "")


def test_every_module_of_the_former_reference() -> None:
    lines = [f"from {module} import {name}; print({name!r})" for module, name in PAGES.items()]
    out, err = printed("\n".join(lines))
    assert out.split() == list(PAGES.values())
    for module in PAGES:
        assert re.search(rf"FutureWarning: {re.escape(module)}\b.* is now ", err), module


def test_nothing_warns_of_itself() -> None:
    printed("import rig, rig.__main__, compensator.inverse.inverse, rig.daemon.desk", "-W", "error::FutureWarning")


def test_a_name_that_never_was() -> None:
    with pytest.raises(ImportError):
        from compensator.inverse import nothing  # type: ignore[attr-defined]  # noqa: F401
    with pytest.raises(ModuleNotFoundError):
        import compensator.nothing  # type: ignore[import-not-found]  # noqa: F401
