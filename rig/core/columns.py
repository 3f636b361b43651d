"""A row's columns, by the names that files, the history and the page have for them; the unit is a name's ending."""

from __future__ import annotations

from typing import Final

MEASURED: Final = ("temperature_degC", "resistance_ohm", "current_A", "meter_current_A")
ACTED: Final = (  # when it was read, when the command acted, and when the test current came on
    "resistance_time_s",
    "current_time_s",
    "meter_current_time_s",
)
WANTED: Final = ("setpoint_degC", "reference_degC", "target_ohm", "predicted_ohm")
BESIDE: Final = ("setpoint_degC", "target_ohm", "ambient_degC", "sink_degC", "input_2")  # of a record that is not ours
OF_A_RUN: Final = ("time_s", *MEASURED, *ACTED, *WANTED, "acts_after_s", "tick", "phase")
OF_A_RECORD: Final = ("time_s", *MEASURED, *ACTED, *BESIDE)
GUESSED: Final = ("time_s", *MEASURED, *BESIDE)  # of a record, where their names say it
KEPT: Final = (*MEASURED, *WANTED)  # in the history, beside time and words
