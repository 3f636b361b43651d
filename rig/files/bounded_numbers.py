"""The kinds of numbers that a configuration has, each within bounds.

Beyond them a number is a slip of the pen: no rig has such currents, temperatures, noise or patience, and nothing that
is computed from them is a number. They are wide, so that whoever has a reason is not in their way.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from rig.core.clock import DAY_S

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
