"""A configuration with another model, as a text that may lie anywhere: what it names is named by whole paths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomli_w

from rig.files.toml_text import read_toml

FILES = (("experiment", "target"), ("experiment", "learned"), ("simulation", "film", "model"))
LEFT_OUT = ("serve", "sweep", "epics")  # they say nothing of an experiment, and [serve] may hold secrets


def extended_configuration(path: Path, model: Path) -> str:
    """The configuration at `path` with this model in experiment.model and no laws to compare with. Raises Faults."""
    raw = {name: table for name, table in read_toml(path).items() if name not in LEFT_OUT}
    raw["experiment"] = {**_table(raw.get("experiment")), "model": str(model.absolute()), "compare": []}
    for place in FILES:
        _make_whole(raw, place, path.parent)
    simulation = _table(raw.get("simulation"))
    if isinstance(simulation.get("effect_files"), list):
        simulation["effect_files"] = [_whole(name, path.parent) for name in simulation["effect_files"]]
    for role in ("controller", "meter"):
        table = _table(_table(raw.get("bench")).get(role))
        if ".py:" in str(table.get("driver")):
            table["driver"] = _whole(table["driver"], path.parent)
    return tomli_w.dumps(raw)


def _table(value: Any) -> dict[str, Any]:
    """What is no table is left for the schema to refuse."""
    return value if isinstance(value, dict) else {}


def _make_whole(raw: dict[str, Any], place: tuple[str, ...], folder: Path) -> None:
    *tables, key = place
    inner = raw
    for name in tables:
        inner = _table(inner.get(name))
    if key in inner:
        inner[key] = _whole(inner[key], folder)


def _whole(name: Any, folder: Path) -> Any:
    """A path from a configuration in a folder; what is no text (a profile in words) stays."""
    return str((folder / name).absolute()) if isinstance(name, str) else name
