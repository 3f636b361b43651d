"""Schemas of TOML tables (pydantic), the bounds of their numbers, and a line for each fault with file and key.

Bounds are wide: a number beyond them is a slip of the pen, no rig has such currents, temperatures, noise or patience.
Faults show the value, shortened; a secret is never shown.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, SecretStr, ValidationError

from rig.config.toml_file import shown
from rig.core.clock import DAY_S
from rig.core.faults import Faults

LARGEST = 1e6  # A, K, ohm per A, s: six digits before the point in any unit of a key here
HOTTEST_START_DEGC = 150.0  # no rig starts above; limits in kelvin are above down to -123 degC
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(ge=1e-12, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
Wait = Annotated[float, Field(ge=0.0, le=DAY_S)]  # s: of something that is over within a day
Period = Annotated[float, Field(ge=1e-3, le=3600.0)]  # s: no line carries a thousand exchanges a second
Span = Annotated[float, Field(ge=1e-3, le=DAY_S)]  # s: of a watch or a forecast that has to end
Days = Annotated[float, Field(gt=0.0, le=100_000.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


def _check_range(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError("expected [low, high] with low < high")
    if not -273.15 <= pair[0] <= pair[1] <= LARGEST:
        raise ValueError(f"expected degC, -273.15 to {LARGEST:g}")
    return pair


def _check_not_kelvin(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] >= HOTTEST_START_DEGC:
        low, high = (round(kelvin - 273.15, 2) for kelvin in pair)
        raise ValueError(f"expected degC, with room temperature inside; in kelvin this would be [{low:g}, {high:g}]")
    return pair


def _check_host(text: str) -> str:
    if not re.fullmatch(r"(https?://)?([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?", text):
        raise ValueError("expected a name, as in bench.lab.example, or an origin, as in https://bench.lab.example")
    return text


Range = Annotated[tuple[float, float], AfterValidator(_check_range)]  # degC
Limits = Annotated[Range, AfterValidator(_check_not_kelvin)]  # degC, of a plate
HostName = Annotated[str, AfterValidator(_check_host)]  # a name or an origin by which browsers reach a page


class Table(BaseModel):
    """A TOML table; unknown keys are refused, values stay as they were read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


T = TypeVar("T", bound=BaseModel)


def validate(schema: type[T], content: dict[str, Any], path: Path) -> T:
    """Return the content as an instance of the schema. Raises Faults with a line for each fault."""
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise Faults(_line(schema, path, *item) for item in _faults(content, error.errors())) from None


def _faults(content: dict[str, Any], errors: Sequence[Any]) -> Iterator[tuple[list[str], Any]]:
    """Yield place and error of each fault. For a value that may have several kinds pydantic gives an error for each
    kind: they become one, and only the errors inside the value are given if a kind fits but for these."""
    found: dict[tuple[str, ...], list[Any]] = {}
    for error in errors:
        found.setdefault(_place(content, error), []).append(error)
    for place, same in found.items():
        if not any(other != place and other[: len(place)] == place for other in found):
            messages = dict.fromkeys(error["msg"].removeprefix("Input should be ") for error in same)
            text = f"Input should be {' or '.join(messages)}" if len(same) > 1 else same[0]["msg"]
            yield list(place), {**same[0], "msg": text}


def _place(content: Any, error: Any) -> tuple[str, ...]:
    """Return the keys that lead to an error in the file, without the kinds that pydantic tried."""
    place = []
    for k, part in enumerate(error["loc"]):
        last = k == len(error["loc"]) - 1
        inside = isinstance(content, list) and isinstance(part, int) and part < len(content)
        if inside or (isinstance(content, dict) and part in content):
            content = content[part]
        elif error["type"] != "missing" or not last:
            continue
        place.append(str(part))
    return tuple(place)


def _line(schema: type[BaseModel], path: Path, place: list[str], error: Any) -> str:
    where = ".".join(place) or "the file"
    if error["type"] == "extra_forbidden":
        keys = list(_fields_at(schema, place[:-1]))
        near = difflib.get_close_matches(place[-1], keys, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        return f"{path}: {where}: unknown key{hint} (known here: {', '.join(sorted(keys))})"
    if error["type"] == "missing":
        return f"{path}: {where}: missing; expected a value"
    message = str(error["msg"]).removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    value = error.get("input")
    hidden = isinstance(value, dict) or _is_secret(schema, place)
    return f"{path}: {where}: {'' if hidden else f'{shown(value)}: '}{message}"


def _is_secret(schema: type[BaseModel], place: list[str]) -> bool:
    """Return True if a secret stands at a place, or should stand in a table there."""
    if not place:
        return False
    field = _fields_at(schema, place[:-1]).get(place[-1])
    inner = _types_in(field.annotation) if field is not None else []
    tables = [a for a in inner if hasattr(a, "model_fields")]
    return SecretStr in inner or any(
        SecretStr in _types_in(each.annotation) for table in tables for each in table.model_fields.values()
    )


def _fields_at(schema: type[BaseModel], place: list[str]) -> dict[str, Any]:
    """Return the schema's fields of the table at a place; none if it has no such table."""
    model: Any = schema
    for part in place:
        if part.isdigit():  # the index in a list of tables
            continue
        field = getattr(model, "model_fields", {}).get(part)
        if field is None:
            return {}
        model = next((each for each in _types_in(field.annotation) if hasattr(each, "model_fields")), None)
    return dict(getattr(model, "model_fields", {}))


def _types_in(annotation: Any) -> list[Any]:
    return [annotation, *(each for inner in getattr(annotation, "__args__", ()) for each in _types_in(inner))]
