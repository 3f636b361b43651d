"""What `./peltier` makes of its environment."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest


def launcher(root: Path, monkeypatch: pytest.MonkeyPatch, *words: str) -> ModuleType:
    """`./peltier WORDS` as a module, before it has done anything but look at the words."""
    monkeypatch.setattr("sys.argv", ["peltier", *words])
    loader = importlib.machinery.SourceFileLoader("launcher", str(root / "peltier"))
    spec = importlib.util.spec_from_loader("launcher", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def test_whoever_wants_no_bytecode_beside_the_sources_gets_it_elsewhere(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert environment["PYTHONPATH"].split(os.pathsep)[0] == str(root)
