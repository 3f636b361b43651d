"""Device errors of Meerstetter TEC controllers (parameter 105): what each means, and what clears it.

Source: "TEC-Family User Manual" 5216G, its table of error numbers, also as `api/error_numbers.txt` in pyMeComTEC, in
our own words. Every one of them takes the output off and stays until the device is reset (`RS`).
"""

from __future__ import annotations

EMERGENCY_STOP, TOO_HOT, WATCHDOG = 11, 60, 183  # device errors, by the maker's error numbers
RESET = "`peltier check CONFIG --clear` resets the device"

BROKEN = "if it comes back, the device is broken"
LOAD = "load its parameter file with the maker's program"
WAIT = "wait until the plate is within limits.temperature_degC"

# first and last number: meaning, what has to be done before the reset
KINDS: tuple[tuple[int, int, str, str], ...] = (
    (1, 10, "its processor has failed", f"switch its supply off and on; {BROKEN}"),
    (11, 11, "emergency stop", "this program sent it, as the output did not go off: find out why before the next run"),
    (12, 12, "a hand terminal that released it has fallen silent", "release it again"),
    (20, 21, "its parameters are damaged inside", LOAD),
    (22, 24, "its parameters are empty, damaged or of another firmware", LOAD),
    (25, 29, "its firmware read a parameter that it cannot use", LOAD),
    (30, 30, "supply voltage too low", "check the supply's voltage and its current limit"),
    (31, 31, "supply voltage too high", "check the supply's voltage"),
    (32, 37, "one of its internal supplies is out of range", f"check the supply; {BROKEN}"),
    (50, 52, "its flash memory fails", BROKEN),
    (53, 53, "it could not send the answer", "look for another program on the same line"),
    (60, 60, "device too hot", "let it cool down: check its airflow, its mounting and the current"),
    (61, 61, "it cannot talk to its input and output hardware", BROKEN),
    (100, 103, "over-current at its output", "check the element and its cables for a short, and the threshold 2032"),
    (104, 105, "over-voltage at its output", "check the element and its cables for a break, and the threshold 2033"),
    (106, 106, "current leaks away at its output", "check the cables' insulation"),
    (107, 107, "over-current, switched off at once", "check the element and its cables for a short"),
    (108, 108, "its output stage is at its end", "lower the current or voltage limit, or raise the supply voltage"),
    (109, 109, "the currents of its two output drivers differ", f"check the cables for a leak; {BROKEN}"),
    (110, 110, "its largest output power is reached", "lower the current limit"),
    (111, 111, "the element's resistance is too low for this supply", "lower the current limit or the supply voltage"),
    (120, 123, "its current measurement is off at the start", f"nothing may drive its output from outside; {BROKEN}"),
    (130, 132, "its thermometer circuit has failed", BROKEN),
    (133, 133, "object sensor out of range (too low: shorted, or of another type)", "check the sensor and its cable"),
    (134, 134, "object sensor out of range (too high: open, or of another type)", "check the sensor and its cable"),
    (137, 137, "object temperature below its error limit (4010)", WAIT),
    (138, 138, "object temperature above its error limit (4011)", WAIT),
    (139, 139, "object temperature changes too fast (4012)", "check the sensor's contact and cable"),
    (140, 141, "sink sensor out of range", "check the sink sensor and its cable"),
    (142, 143, "sink temperature beyond its error limits", "let the heat sink cool down: check its fan"),
    (144, 144, "sink temperature changes too fast", "check the sink sensor's contact and cable"),
    (150, 153, "its thermometer circuit gives impossible values", f"check the sensor; {BROKEN}"),
    (160, 165, "its link to another board fails", "check the cable between the boards, and their firmware"),
    (170, 173, "its tuning of itself has failed", "start it again when the temperature rests, or not at all"),
    (175, 176, "its fan does not turn as fast as it should", "check the fan"),
    (180, 181, "a lookup table in it cannot be read", "load the table again with the maker's program"),
    (182, 182, "the temperature did not become stable in its own time", "check its stability settings"),
    (183, 183, "communication watchdog: nothing was heard from the program for the dead man's time", ""),
    (184, 184, "its display's text cannot be read", "set the display again with the maker's program"),
)


def meaning_of(number: int) -> tuple[str, str]:
    """What an error means, and what to do about it, in words."""
    for first, last, meaning, first_of_all in KINDS:
        if first <= number <= last:
            return meaning, f"{first_of_all}; {RESET}" if first_of_all else RESET
    return "see the manual", f"see the manual's table of error numbers; {RESET}"
