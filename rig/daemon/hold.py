"""A hold that somebody asks for by its temperature alone: the bench's own configuration with another [experiment].

All that guards the bench is as the bench has it. The plate's model is the bench's latest, where there is one: then the
film's law holds the temperature; without one the controller's own regulation does.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from rig.config.configuration import ConfigurationFile, configuration_of
from rig.config.model_file import read_model
from rig.config.toml_file import parsed_toml, shown
from rig.core.clock import DAY_S
from rig.core.faults import Faults, fault

USUAL_S = 600.0  # of a hold whose time nobody gives: long enough to look at a film, too short to be forgotten
LONGEST_S = 7 * DAY_S  # longer holds are written down in a configuration
HEADER = re.compile(r"\s*\[{1,2}\s*([\w.\-]+)\s*\]{1,2}\s*(#.*)?")


def hold_of(bench: ConfigurationFile, degC: object, seconds: object, model: Path | None) -> ConfigurationFile:
    """The configuration of a hold on a bench. Raises Faults: no number, beyond the bench's limits."""
    low, high = bench.content.limits.temperature_degC
    lines = []
    if not _is_number(degC) or not low < float(degC) < high:  # type: ignore[arg-type]
        lines.append(f"hold_degC: {shown(degC)}: expected a number between the bench's limits, {low:g} and {high:g}")
    if not _is_number(seconds) or not 1.0 <= float(seconds) <= LONGEST_S:  # type: ignore[arg-type]
        lines.append(f"hold_s: {shown(seconds)}: expected a number from 1 to {LONGEST_S:g}")
    if lines:
        raise Faults(lines)
    experiment: dict[str, Any] = {
        "kind": "hold",
        "name": "hold",
        "target": [f"start {float(degC)!r} degC", f"hold {float(seconds)!r} s"],  # type: ignore[arg-type]
        "period_s": bench.content.experiment.period_s,
        **({"model": str(model)} if _has_plate(model) else {"law": "instrument_pid"}),
    }
    text = "\n".join([*_without_experiment(bench.text), "", "[experiment]", *_lines(experiment), ""])
    others = {key: value for key, value in parsed_toml(bench.text, bench.path).items() if key != "experiment"}
    try:
        raw = parsed_toml(text, bench.path)
    except Faults:
        raw = {}
    if raw != {**others, "experiment": experiment}:  # it is written in some other way, as experiment.kind = ...
        raise fault(bench.path, "experiment", "expected as a table [experiment], so that a hold can take its place")
    return configuration_of(bench.path, text, raw)


def _without_experiment(text: str) -> list[str]:
    """The lines of a configuration but those of its table [experiment]."""
    kept, inside = [], False
    for line in text.splitlines():
        header = HEADER.fullmatch(line)
        inside = header[1] == "experiment" if header is not None else inside
        if not inside:
            kept.append(line)
    return kept


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _has_plate(model: Path | None) -> bool:
    """Whether there is a model that tells how to drive the plate."""
    if model is None or not model.is_file():
        return False
    try:
        return read_model(model).plate is not None
    except Faults:
        return False


def _lines(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {_shown(value)}" for key, value in table.items()]


def _shown(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, list):
        return f"[{', '.join(_shown(one) for one in value)}]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)
