"""Effects as files and the command line name them: [[effects]] tables, NAME:param=value, and files of a user's own.

A parameter that is left out, where that is allowed, takes the geometric middle of its usual sizes.
"""

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

BELONGS_TO_FILM = "belongs to the film: give the simulated film its [film.memoryless] instead"
_added: dict[tuple[Path, int], Effect] = {}


def middle(parameter: Parameter) -> float:
    """The geometric middle of the usual sizes; of choices, the nearest."""
    value = math.sqrt(parameter.smallest * parameter.largest)
    if parameter.choices:
        return min(parameter.choices, key=lambda choice: abs(math.log(choice / value)))
    return value


def add_effect_files(paths: Iterable[Path]) -> None:
    """Make effects of a user's own known, each in a Python file with an `EFFECT`. Raises Faults."""
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
        except Exception as error:  # whatever a user's file does when it is imported
            lines.append(_import_fault(path, error))
    if lines:
        raise Faults(lines)


def _import_fault(path: Path, error: Exception) -> str:
    """One line for what a user's file raised: where in it, and what. Of a compiler's error the reason alone, which
    stands in several lines between what the compiler was doing, with a terminal's colours."""
    plain = [line.strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()]
    reasons = [line for line in plain if line and not line.startswith(("Failed in", "During:"))] or [""]
    here = path.resolve()
    frames = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).resolve() == here]
    compiled = getattr(error, "loc", None)  # of a compiler's error: a line inside the function that it compiled
    if compiled is not None and Path(str(compiled.filename)).resolve() == here:
        frames.append(compiled.line)
    number = frames[-1] if frames else None
    where = f"{path}: line {number}" if number is not None else f"{path}"
    kind = "" if re.match(r"\w+Error: ", reasons[0]) else f"{type(error).__name__}: "
    return f"{where}: {kind}{reasons[0]}"


def assumed_effects(texts: Iterable[str]) -> dict[str, dict[str, float]]:
    """--assume NAME[:param=value,...]: the parameters that are known, by effect and name. Raises Faults."""
    return assumed([effect_in_words(text, "--assume") for text in texts], "--assume")


def assumed(tables: Iterable[Mapping[str, Any]], where: str) -> dict[str, dict[str, float]]:
    """The same of tables with a name and what is known. Raises Faults."""
    found: dict[str, dict[str, float]] = {}
    lines, known = [], catalogue()
    for table in tables:
        name = table["name"]
        if name not in known:
            lines.append(f"{where}: {_unknown(name, known)}")
            continue
        if name in found:
            lines.append(f"{where}: {name}: given twice; expected once, as {name}:param=value,param=value")
        _, faults = _values(known[name], table, complete=False)
        lines += [f"{where}: {name}: {fault}" for fault in faults]
        found[name] = {key: value for key, value in table.items() if key != "name"}
    if lines:
        raise Faults(lines)
    return found


def effect_in_words(text: str, option: str = "--effect") -> dict[str, Any]:
    """NAME[:param=value,...] as a table. option: where it was given. Raises Faults."""
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


def switched_effects(
    tables: Iterable[Mapping[str, Any]], where: str, *, complete: bool = True
) -> tuple[tuple[Switched, ...], list[str]]:
    """The effects of the tables, and a line for each fault. complete: whether each parameter must be there."""
    effects, lines, known = [], [], catalogue()
    for k, table in enumerate(tables):
        place = f"{where}[{k}]"
        name = table.get("name")
        if not isinstance(name, str) or name not in known:
            lines.append(f"{place}: {_unknown(name, known)}")
            continue
        effect = known[name]
        values, faults = _values(effect, table, complete)
        lines += [f"{place}: {name}: {text}" for text in faults]
        if not faults:
            effects.append(switched(effect, values))
    try:
        links_of(effects)
    except ValueError as error:
        lines.append(f"{where}: {error}")
    return tuple(effects), lines


def _values(effect: Effect, table: Mapping[str, Any], complete: bool) -> tuple[dict[str, float], list[str]]:
    """The parameters by name, and what is wrong with them."""
    parameters = {p.name: p for p in effect.parameters}
    faults = []
    for key in table:
        if key != "name" and key not in parameters:
            near = difflib.get_close_matches(key, parameters, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            faults.append(f"no parameter {key!r}; {hint}expected {', '.join(parameters)}")
    values = {}
    for name, p in parameters.items():
        if name not in table:
            if complete:
                faults.append(f"{name}: missing; expected a number")
            else:
                values[name] = middle(p)
            continue
        value = table[name]
        number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value == 0.0 or (value < 0.0 and not p.signed):
            sign = "not 0" if p.signed else "> 0"
            met = f"usual: {p.smallest:g} to {p.largest:g}{', either sign' if p.signed else ''}"
            faults.append(f"{name}: {value!r}: expected a finite number {sign}; {met}")
        else:
            values[name] = float(value)
    return values, faults


def _unknown(name: object, known: Mapping[str, Effect]) -> str:
    if name == memoryless_term.NAME:
        return f"{name}: {BELONGS_TO_FILM}"
    if name is None:
        return f"name: missing; expected one of {', '.join(known)}"
    near = difflib.get_close_matches(str(name), known, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return f"{name!r} is no effect; {hint}expected one of {', '.join(known)}"
