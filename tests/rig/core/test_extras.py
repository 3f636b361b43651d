"""What to type for a package that is missing: what pyproject.toml asks for, for the Python that runs."""

from __future__ import annotations

import shlex
import sys
import tomllib
from pathlib import Path

from rig.core.requirements import PACKAGES, to_install

PROJECT = Path(__file__).resolve().parents[3] / "pyproject.toml"


def test_the_packages_are_those_of_the_project() -> None:
    extras = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert {name: list(packages) for name, packages in PACKAGES.items()} == {name: extras[name] for name in PACKAGES}
    assert shlex.split(to_install("files")) == [sys.executable, "-m", "pip", "install", "openpyxl>=3.1"]
