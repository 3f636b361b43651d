"""One row of the history from what was read."""

from __future__ import annotations

from rig.core.reading import Quality, Reading


def quality_of(temperature: Reading, resistance: Reading | None) -> str:
    """In a word: good, or what is wrong with the thermometer's reading, else with the ohmmeter's."""
    for reading in (temperature, resistance):
        if reading is not None and not reading.is_number:
            return "overrange" if reading.quality is Quality.OVERRANGE else str(reading.quality.value)
    return "good"
