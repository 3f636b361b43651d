"""The kinds of numbers that a configuration has, each within bounds.

Beyond them a number is a slip of the pen: no rig has such currents, temperatures, noise or patience, and nothing that
is computed from them is a number. They are wide, so that whoever has a reason is not in their way.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from rig.core.clock import DAY_S

LARGEST = 1e6  # A, K, ohm per A, s: six digits before the point in any unit that a key here has
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


Range = Annotated[tuple[float, float], AfterValidator(_ordered)]
