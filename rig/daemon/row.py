"""One row of the history from what was read."""

from __future__ import annotations

import math
from typing import Any

from rig.core.reading import Quality, Reading


def row_of(
    time_s: float, temperature: Reading, resistance: Reading | None, current_A: float, test_current_A: float
) -> dict[str, Any]:
    """What every row has, whoever reads; nan where there is nothing to show. A resistance beyond the range is
    infinite, a temperature beyond it is not told."""
    seen = resistance is not None and (resistance.is_number or resistance.quality is Quality.OVERRANGE)
    return {
        "time_s": time_s,
        "temperature_degC": temperature.value if temperature.is_number else math.nan,
        "resistance_ohm": resistance.value if seen and resistance is not None else math.nan,
        "current_A": current_A,
        "meter_current_A": test_current_A,
        "quality": quality_of(temperature, resistance),
    }


def quality_of(temperature: Reading, resistance: Reading | None) -> str:
    """In a word: good, or what is wrong with the thermometer's reading, else with the ohmmeter's."""
    for reading in (temperature, resistance):
        if reading is not None and not reading.is_number:
            return "overrange" if reading.quality is Quality.OVERRANGE else str(reading.quality.value)
    return "good"
