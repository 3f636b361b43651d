"""Names of a film's output, as in model files.

    minus_log10_ohm    -log10(R / 1 ohm): of a film whose resistance falls when it is heated
    log10_ohm          log10(R / 1 ohm): of a film whose resistance rises
    NAME_UNIT          a column of the record, such as curvature_per_m
    minus_NAME_UNIT    its negative, of a film that lowers it when it is heated

A film model's output rises with temperature, so that each quantity has a name for either sign.
"""

from __future__ import annotations

import math
from collections.abc import Container

FALLING_RESISTANCE, RISING_RESISTANCE = "minus_log10_ohm", "log10_ohm"
MINUS = "minus_"


def in_decades(output: str) -> bool:
    """Return True if the output is a resistance on a log scale."""
    return output in (FALLING_RESISTANCE, RISING_RESISTANCE)


def is_negative(output: str, columns: Container[str] = ()) -> bool:
    """Return True if the output is a column's negative, and no column has the whole name."""
    return output.startswith(MINUS) and not in_decades(output) and output not in columns


def column_of(output: str, columns: Container[str] = ()) -> str:
    """Return the record's column that the output is computed from."""
    if in_decades(output):
        return "resistance_ohm"
    return output.removeprefix(MINUS) if is_negative(output, columns) else output


def other_sign(output: str) -> str:
    """Return the name of the same quantity with the other sign."""
    if in_decades(output):
        return RISING_RESISTANCE if output == FALLING_RESISTANCE else FALLING_RESISTANCE
    return output.removeprefix(MINUS) if output.startswith(MINUS) else MINUS + output


def sign_of(output: str) -> float:
    """Return the factor from the quantity (log10 R, or the column) to the output."""
    return -1.0 if output.startswith(MINUS) else 1.0


def unit_of(output: str) -> str:
    """Return the output's unit: "dec" (decades) of a resistance, else the ending of the name."""
    return "dec" if in_decades(output) else output.removeprefix(MINUS).partition("_")[2] or "1"


def output_to_ohm(output: float, name: str = FALLING_RESISTANCE) -> float:
    """Return the resistance, ohm; inf if it overflows, as a model's output may far outside its fitted range."""
    try:
        return float(10.0 ** (sign_of(name) * output))
    except OverflowError:
        return math.inf


def output_to_quantity(output: float, name: str) -> float:
    """Return the quantity in its own unit: ohms, or that of the record's column."""
    return output_to_ohm(output, name) if in_decades(name) else sign_of(name) * output
