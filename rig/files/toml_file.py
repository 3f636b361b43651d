"""Reading a TOML file into a checked pydantic schema: every fault at once, with file and key."""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from rig.faults import Faults, fault


class Table(BaseModel):
    """A TOML table: unknown keys are refused, values stay as they were read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


T = TypeVar("T", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """The file's content. Raises Faults where it is missing, unreadable or no TOML."""
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except OSError as error:
        raise fault(path, "", f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise fault(path, f"byte {error.start}", "expected UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise fault(path, "", f"is no TOML: {error}") from None


def checked(schema: type[T], content: dict[str, Any], path: Path) -> T:
    """The content as an instance of the schema. Raises Faults with a line for each fault."""
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise Faults(_line(schema, content, path, item) for item in error.errors()) from None


def _line(schema: type[BaseModel], content: dict[str, Any], path: Path, error: Any) -> str:
    place = [str(part) for part in error["loc"]]
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
    shown = "" if isinstance(value, dict) else f"{value!r}: "
    return f"{path}: {where}: {shown}{message}"


def _keys(schema: type[BaseModel], place: list[str]) -> list[str]:
    """The keys that a table of the schema knows."""
    model: Any = schema
    for part in place:
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
