"""Reading a TOML file into a checked pydantic schema: every fault at once, with file and key.

A value is shown with its fault, shortened; one that is secret, never.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, SecretStr, ValidationError

from rig.config.toml_file import shown
from rig.core.clock import DAY_S
from rig.core.faults import Faults


class Table(BaseModel):
    """A TOML table: unknown keys are refused, values stay as they were read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


T = TypeVar("T", bound=BaseModel)


def checked(schema: type[T], content: dict[str, Any], path: Path) -> T:
    """The content as an instance of the schema. Raises Faults with a line for each fault."""
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise Faults(_line(schema, path, *item) for item in _one_each(content, error.errors())) from None


def _one_each(content: dict[str, Any], errors: Sequence[Any]) -> list[tuple[list[str], Any]]:
    """(place, error) of each fault. Where one of several kinds was expected there is an error for each of the kinds;
    those become one, or, where a kind fits but for something inside it, what is wrong there."""
    faults: list[tuple[list[str], Any]] = []
    choices: dict[tuple[str, ...], list[tuple[str, list[str], Any]]] = {}
    for error in errors:
        place, kinds = _place(content, error)
        if kinds:
            at, kind = kinds[0]
            choices.setdefault(tuple(place[:at]), []).append((kind, place, error))
        else:
            faults.append((place, error))
    for found in choices.values():
        if len({kind for kind, _, _ in found}) == 1:
            faults += [(place, error) for _, place, error in found]
            continue
        deepest = max(len(place) for _, place, _ in found)
        alike: dict[tuple[str, ...], list[Any]] = {}
        for _, place, error in found:
            if len(place) == deepest:
                alike.setdefault(tuple(place), []).append(error)
        for where, same in alike.items():
            messages = dict.fromkeys(error["msg"].removeprefix("Input should be ") for error in same)
            text = f"Input should be {' or '.join(messages)}" if len(same) > 1 else same[0]["msg"]
            faults.append((list(where), {**same[0], "msg": text}))
    return faults


def _place(content: Any, error: Any) -> tuple[list[str], list[tuple[int, str]]]:
    """Where an error is in the file; and the kinds that are no keys of it but names of what was tried, with how far
    down each was."""
    place: list[str] = []
    kinds: list[tuple[int, str]] = []
    for k, part in enumerate(error["loc"]):
        inside = isinstance(content, list) and isinstance(part, int) and part < len(content)
        if inside or (isinstance(content, dict) and part in content):
            content = content[part]
        elif not (error["type"] == "missing" and k == len(error["loc"]) - 1):
            kinds.append((len(place), str(part)))
            continue
        place.append(str(part))
    return place, kinds


def _line(schema: type[BaseModel], path: Path, place: list[str], error: Any) -> str:
    where = ".".join(place) or "the file"
    if error["type"] == "extra_forbidden":
        near = difflib.get_close_matches(place[-1], _keys(schema, place[:-1]), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        known = ", ".join(sorted(_keys(schema, place[:-1])))
        return f"{path}: {where}: unknown key{hint} (known here: {known})"
    if error["type"] == "missing":
        return f"{path}: {where}: missing; expected a value"
    message = str(error["msg"])
    message = message.removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    value = error.get("input")
    told = "" if isinstance(value, dict) or _holds_secrets(schema, place) else f"{shown(value)}: "
    return f"{path}: {where}: {told}{message}"


def _holds_secrets(schema: type[BaseModel], place: list[str]) -> bool:
    """Whether what stands at a place is a secret, or should be a table with one."""
    annotation: Any = schema
    for part in place:
        model = next((a for a in _arguments(annotation) if hasattr(a, "model_fields")), None)
        field = getattr(model, "model_fields", {}).get(part)
        if field is None:
            return False
        annotation = field.annotation
    inner = _arguments(annotation)
    tables = [a for a in inner if hasattr(a, "model_fields")]
    return SecretStr in inner or any(
        SecretStr in _arguments(field.annotation) for table in tables for field in table.model_fields.values()
    )


def _keys(schema: type[BaseModel], place: list[str]) -> list[str]:
    """The keys that a table of the schema knows."""
    model: Any = schema
    for part in place:
        if part.isdigit():  # which one of a list of tables
            continue
        field = getattr(model, "model_fields", {}).get(part)
        if field is None:
            return []
        model = next((arg for arg in _arguments(field.annotation) if hasattr(arg, "model_fields")), None)
    return list(getattr(model, "model_fields", {}))


def _arguments(annotation: Any) -> list[Any]:
    parts = [annotation]
    for inner in getattr(annotation, "__args__", ()):
        parts += _arguments(inner)
    return parts


LARGEST = 1e6  # A, K, ohm per A, s: six digits before the point in any unit that a key here has
HOTTEST_START_DEGC = 150.0  # beyond what any rig is left at; a limit in kelvin is above it down to -123 degC
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(ge=1e-12, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
Wait = Annotated[float, Field(ge=0.0, le=DAY_S)]  # s: for something that is over within a day
Period = Annotated[float, Field(ge=1e-3, le=3600.0)]  # s: no line carries a thousand exchanges a second
Span = Annotated[float, Field(ge=1e-3, le=DAY_S)]  # s: of a watch or a forecast that has to end
Days = Annotated[float, Field(gt=0.0, le=100_000.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError("expected [low, high] with low < high")
    if not -273.15 <= pair[0] <= pair[1] <= LARGEST:
        raise ValueError(f"expected degC, -273.15 to {LARGEST:g}")
    return pair


def _in_degC(pair: tuple[float, float]) -> tuple[float, float]:
    """The same, unless it was meant in kelvin: no plate begins at HOTTEST_START_DEGC."""
    if pair[0] >= HOTTEST_START_DEGC:
        low, high = (round(kelvin - 273.15, 2) for kelvin in pair)
        raise ValueError(f"expected degC, with room temperature inside; in kelvin this would be [{low:g}, {high:g}]")
    return pair


Range = Annotated[tuple[float, float], AfterValidator(_ordered)]
Limits = Annotated[Range, AfterValidator(_in_degC)]  # degC, that a plate may have


def _reachable_name(text: str) -> str:
    if not re.fullmatch(r"(https?://)?([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?", text):
        raise ValueError("expected a name, as in bench.lab.example, or an origin, as in https://bench.lab.example")
    return text


ReachableName = Annotated[str, AfterValidator(_reachable_name)]
