"""What a Meerstetter controller trips on: readings out of bounds or too fast, several conversions in a row."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite

SENSOR_OPEN, BELOW_LIMIT, ABOVE_LIMIT, CHANGED_TOO_FAST = 134, 137, 138, 139  # device errors
LOW, HIGH, FASTEST = 4010, 4011, 4012  # parameters: degC, degC, K/s
TRIP_AFTER = 3  # conversions in a row (assumed, see `sim.instruments.meerstetter`)


class Strikes:
    """How many conversions in a row have been out of bounds, by device error."""

    def __init__(self) -> None:
        self._in_a_row = dict.fromkeys((SENSOR_OPEN, BELOW_LIMIT, ABOVE_LIMIT, CHANGED_TOO_FAST), 0)

    def judged(
        self, temperature_degC: float, before_degC: float, values: Mapping[int, float], step_s: float
    ) -> int | None:
        """The device error that a conversion raises, `step_s` after the one before; None: none."""
        strikes = self._in_a_row
        if values[LOW] <= temperature_degC <= values[HIGH]:
            strikes[SENSOR_OPEN] = strikes[BELOW_LIMIT] = strikes[ABOVE_LIMIT] = 0
        else:
            for number, wrong in (
                (SENSOR_OPEN, not isfinite(temperature_degC)),
                (BELOW_LIMIT, temperature_degC < values[LOW]),
                (ABOVE_LIMIT, temperature_degC > values[HIGH]),
            ):
                strikes[number] = strikes[number] + 1 if wrong else 0
        fast = abs(temperature_degC - before_degC) > values[FASTEST] * step_s
        strikes[CHANGED_TOO_FAST] = strikes[CHANGED_TOO_FAST] + 1 if fast else 0
        return next((number for number, count in strikes.items() if count >= TRIP_AFTER), None)
