"""Effects in files and on the command line: [[effects]] tables, NAME:param=value, and files of user-defined effects."""

from __future__ import annotations

import difflib
import math
import re
import traceback
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rig.core.faults import Faults, fault
from sim.effects import memoryless_term
from sim.effects.catalogue import add_effect_file, catalogue
from sim.effects.effect import Effect, Parameter, Switched, switched
from sim.model.links import links_of

_added: dict[tuple[Path, int], Effect] = {}  # by file and its time, so that an unchanged file is imported once


def typical_value(parameter: Parameter) -> float:
    """Return the geometric mean of a parameter's typical range; of choices, the nearest."""
    value = math.sqrt(parameter.smallest * parameter.largest)
    return min(parameter.choices, key=lambda choice: abs(math.log(choice / value)), default=value)


def add_effect_files(paths: Iterable[Path]) -> None:
    """Add user-defined effects to the catalogue, each from a Python file with an `EFFECT`. Raises Faults."""
    lines = []
    for path in paths:
        try:
            key = (path.resolve(), path.stat().st_mtime_ns)
            if key not in _added:
                _added[key] = add_effect_file(path)
        except FileNotFoundError:
            lines.append(f"{path}: no such file")
        except SyntaxError as error:
            lines.append(f"{path}: line {error.lineno}: {error.msg}")
        except ValueError as error:
            text = str(error)
            lines.append(text if text.startswith(str(path)) else f"{path}: {text}")
        except Exception as error:  # whatever a user's file raises when it is imported
            lines.append(_import_fault(path, error))
    if lines:
        raise Faults(lines)


def _import_fault(path: Path, error: Exception) -> str:
    """Return one line for an exception in a user's file. A compiler's error has several, with a terminal's colours, of
    which only the reason is shown."""
    plain = [line.strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()]
    reasons = [line for line in plain if line and not line.startswith(("Failed in", "During:"))] or [""]
    here = path.resolve()
    frames = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).resolve() == here]
    compiled = getattr(error, "loc", None)  # a line inside the function that is compiled
    if compiled is not None and Path(str(compiled.filename)).resolve() == here:
        frames.append(compiled.line)
    where = f"{path}: line {frames[-1]}" if frames and frames[-1] is not None else f"{path}"
    kind = "" if re.match(r"\w+Error: ", reasons[0]) else f"{type(error).__name__}: "
    return f"{where}: {kind}{reasons[0]}"


def parse_assumed_effects(texts: Iterable[str]) -> dict[str, dict[str, float]]:
    """Return the known parameters of --assume NAME[:param=value,...], by effect and name. Raises Faults."""
    return check_assumed_effects([parse_effect(text, "--assume") for text in texts], "--assume")


def check_assumed_effects(tables: Iterable[Mapping[str, Any]], where: str) -> dict[str, dict[str, float]]:
    """Return the known parameters in tables with an effect's name, by effect and name. Raises Faults."""
    found: dict[str, dict[str, float]] = {}
    lines, known = [], catalogue()
    for table in tables:
        name = table["name"]
        if name not in known:
            lines.append(f"{where}: {_unknown_effect(name, known)}")
            continue
        if name in found:
            lines.append(f"{where}: {name}: given twice; expected once, as {name}:param=value,param=value")
        lines += [f"{where}: {name}: {text}" for text in _parameters(known[name], table, complete=False)[1]]
        found[name] = {key: value for key, value in table.items() if key != "name"}
    if lines:
        raise Faults(lines)
    return found


def parse_effect(text: str, option: str = "--effect") -> dict[str, Any]:
    """Return NAME[:param=value,...] as a table; option: for messages. Raises Faults."""
    name, colon, rest = text.partition(":")
    table: dict[str, Any] = {"name": name.strip()}
    for part in rest.split(",") if colon else []:
        parameter, equals, number = (word.strip() for word in part.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not equals or not parameter or math.isnan(value):
            raise fault(option, repr(text), f"{part!r}: expected NAME:param=value,... with numbers")
        table[parameter] = value
    return table


def switch_effects(
    tables: Iterable[Mapping[str, Any]], where: str, *, complete: bool = True
) -> tuple[tuple[Switched, ...], list[str]]:
    """Return the effects of tables with their values, and a line for each fault.

    complete: each parameter must be there; otherwise a missing one gets its typical value.
    """
    effects, lines, known = [], [], catalogue()
    for k, table in enumerate(tables):
        name = table.get("name")
        if not isinstance(name, str) or name not in known:
            lines.append(f"{where}[{k}]: {_unknown_effect(name, known)}")
            continue
        values, faults = _parameters(known[name], table, complete)
        lines += [f"{where}[{k}]: {name}: {text}" for text in faults]
        if not faults:
            effects.append(switched(known[name], values))
    try:
        links_of(effects)
    except ValueError as error:
        lines.append(f"{where}: {error}")
    return tuple(effects), lines


def _parameters(effect: Effect, table: Mapping[str, Any], complete: bool) -> tuple[dict[str, float], list[str]]:
    """Return an effect's parameters by name, and their faults."""
    parameters = {p.name: p for p in effect.parameters}
    unknown = [key for key in table if key != "name" and key not in parameters]
    faults = [f"no parameter {key!r}; {_hint(key, parameters)}expected {', '.join(parameters)}" for key in unknown]
    values = {}
    for name, p in parameters.items():
        if name not in table:
            if complete:
                faults.append(f"{name}: missing; expected a number")
            else:
                values[name] = typical_value(p)
            continue
        value = table[name]
        number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value == 0.0 or (value < 0.0 and not p.signed):
            sign = "not 0" if p.signed else "> 0"
            usual = f"usual: {p.smallest:g} to {p.largest:g}{', either sign' if p.signed else ''}"
            faults.append(f"{name}: {value!r}: expected a finite number {sign}; {usual}")
        else:
            values[name] = float(value)
    return values, faults


def _hint(name: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {near[0]!r}? " if near else ""


def _unknown_effect(name: object, known: Mapping[str, Effect]) -> str:
    if name == memoryless_term.NAME:
        return f"{name}: belongs to the film: give the simulated film its [film.memoryless] instead"
    if name is None:
        return f"name: missing; expected one of {', '.join(known)}"
    return f"{name!r} is no effect; {_hint(str(name), known)}expected one of {', '.join(known)}"
