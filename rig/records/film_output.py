"""Names of a film's output, as model files have them, and what they stand for.

    minus_log10_ohm    -log10(R / 1 ohm): of a film whose resistance falls as it is heated
    log10_ohm          log10(R / 1 ohm): of one whose resistance rises
    NAME_UNIT          a column of the record, as curvature_per_m
    minus_NAME_UNIT    its negative, of a film that lowers it as it is heated

A film model's output rises with temperature, so that each quantity has a name for either sense.
"""

from __future__ import annotations

import math
from collections.abc import Container

FALLING_RESISTANCE, RISING_RESISTANCE = "minus_log10_ohm", "log10_ohm"
MINUS = "minus_"


def in_decades(output: str) -> bool:
    """Whether it is a resistance on a log scale."""
    return output in (FALLING_RESISTANCE, RISING_RESISTANCE)


def is_negative(output: str, columns: Container[str] = ()) -> bool:
    """Whether it is the negative of a column: not so where the record has a column of the whole name."""
    return output.startswith(MINUS) and not in_decades(output) and output not in columns


def column_of(output: str, columns: Container[str] = ()) -> str:
    """The record's column that it is made of."""
    if in_decades(output):
        return "resistance_ohm"
    return output.removeprefix(MINUS) if is_negative(output, columns) else output


def other_sense(output: str) -> str:
    """The same quantity with the other sign."""
    if in_decades(output):
        return RISING_RESISTANCE if output == FALLING_RESISTANCE else FALLING_RESISTANCE
    return output.removeprefix(MINUS) if output.startswith(MINUS) else MINUS + output


def sign_of(output: str) -> float:
    """Of the output by its quantity: log10 R, or the column."""
    return -1.0 if output.startswith(MINUS) else 1.0


def unit_of(output: str) -> str:
    """The unit of a film's output, for people and for keys: decades of a resistance, else what the name ends in."""
    return "dec" if in_decades(output) else output.removeprefix(MINUS).partition("_")[2] or "1"


def ohm(output: float, name: str = FALLING_RESISTANCE) -> float:
    """R in ohm of an output of that name. A model may say more decades than a number has, far outside what it was
    fitted to: infinite then, where Python's own power would raise in the middle of a run."""
    try:
        return float(10.0 ** (sign_of(name) * output))
    except OverflowError:
        return math.inf


def shown_output(output: float, name: str) -> float:
    """The quantity in its own unit: ohms, or that of the record's column."""
    return ohm(output, name) if in_decades(name) else sign_of(name) * output
