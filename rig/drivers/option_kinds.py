"""Whether an instrument's options are of the kinds that its driver says: text, a number, yes or no."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

IN_WORDS = {int: "a whole number", float: "a finite number", str: "text in quotes", bool: "true or false"}


def check_kinds(driver: Any, options: Mapping[str, Any]) -> None:
    """Raises ValueError where an option is of another kind than the driver's annotation.

    What an annotation says in no simple words, or does not say, is left to the driver.
    """
    try:
        hints = get_type_hints(driver.__init__)
    except (NameError, TypeError):  # of a driver of the user's own, whose annotations mean nothing here
        return
    for name, value in options.items():
        hint = hints.get(name, Any)
        parts = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        kinds = [get_origin(part) or part for part in parts]
        if hint is Any or not all(isinstance(kind, type) for kind in kinds):
            continue
        if not any(_is(value, kind) for kind in kinds):
            words = [IN_WORDS.get(kind, f"a {kind.__name__}") for kind in kinds if kind is not NoneType]
            raise ValueError(f"{name} {value!r}: {' or '.join(words)} is expected")


def check_gains(**gains: tuple[float | None, float, float]) -> None:
    """Raises ValueError where a gain is given that the instrument does not take: of each the value (None: not given),
    the least and the largest."""
    for name, (gain, low, high) in gains.items():
        if gain is not None and not low <= gain <= high:
            raise ValueError(f"{name} {gain!r}: {low:g} to {high:g} is expected")


def _is(value: Any, kind: type) -> bool:
    """A whole number is a number too; yes and no are none."""
    if kind is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
