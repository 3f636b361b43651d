"""What `./peltier` makes of its environment."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
from pathlib import Path

import pytest


def test_whoever_wants_no_bytecode_beside_the_sources_gets_it_elsewhere(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiled again in each process, a run's modules would take a second and a half."""
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.delenv("PYTHONPYCACHEPREFIX", raising=False)
    monkeypatch.setattr("sys.argv", ["peltier"])
    loader = importlib.machinery.SourceFileLoader("launcher", str(root / "peltier"))
    spec = importlib.util.spec_from_loader("launcher", loader)
    assert spec is not None
    loader.exec_module(importlib.util.module_from_spec(spec))
    assert "PYTHONDONTWRITEBYTECODE" not in os.environ
    assert os.environ["PYTHONPYCACHEPREFIX"] == str(root / ".venv" / "bytecode")
    monkeypatch.delenv("PYTHONPYCACHEPREFIX")
