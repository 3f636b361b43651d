"""The interlock: a small file of its own, outside the control law, that a wrong model cannot argue with.

It is given every tick's readings and the command that the law wants to send, and either lets it pass or raises
`Tripped`; it never corrects a value in silence. What follows a trip (output off, confirmed) is not its business.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rig.core.outcome import Tripped
from rig.core.reading import Quality, Reading


@dataclass(frozen=True)
class Limits:
    """What must hold. stale_s: how old the last good reading may be.

    rate_K_per_s: faster than any plate. runaway_s: for how long it may go against the current.
    """

    low_degC: float
    high_degC: float
    current_A: float
    meter_current_A: float
    stale_s: float
    rate_K_per_s: float = 20.0
    runaway_s: float = 20.0


@dataclass(frozen=True)
class Watch:
    """When the last good readings of the two instruments were taken (s)."""

    temperature_s: float
    resistance_s: float


def check_readings(
    limits: Limits,
    watch: Watch,
    now_s: float,
    temperature: Reading,
    resistance: Reading | None,
    why: tuple[str, str] = ("", ""),
) -> Watch:
    """The watch brought up to date. Raises Tripped: temperature out of limits, or no good reading for too long.

    why: of each instrument, in words, why its reading is none. A good reading after too long a time does not heal it:
    nobody knows what plate and film did meanwhile.
    """
    if temperature.is_number and not limits.low_degC <= temperature.value <= limits.high_degC:
        text = (
            f"temperature {temperature.value:.3f} degC is outside the limits "
            f"[{limits.low_degC:g}, {limits.high_degC:g}] degC"
        )
        raise Tripped("temperature_limit", text, now_s)
    for name, last_s, reason in (
        ("thermometer", watch.temperature_s, why[0]),
        ("ohmmeter", now_s if resistance is None else watch.resistance_s, why[1]),
    ):
        if now_s - last_s > limits.stale_s:
            text = f"no good reading of the {name} for {now_s - last_s:.2f} s; expected one every {limits.stale_s:g} s"
            raise Tripped(f"{name}_stale", text + (f"; {reason}" if reason else ""), now_s)
    if temperature.is_number:
        watch = replace(watch, temperature_s=now_s)
    if resistance is None or resistance.is_number or resistance.quality is Quality.OVERRANGE:
        watch = replace(watch, resistance_s=now_s)
    return watch


def check_current(limits: Limits, now_s: float, current_A: float) -> None:
    """Raises Tripped where a current is no number or beyond the limit."""
    if not math.isfinite(current_A) or abs(current_A) > limits.current_A * (1.0 + 1e-9):
        text = f"the law asked for {current_A!r} A; the limit is {limits.current_A:g} A"
        raise Tripped("current_limit", text, now_s)


def check_test_current(limits: Limits, now_s: float, test_current_A: float) -> None:
    """Raises Tripped where the meter's test current is above the limit; nan (not known) passes."""
    if test_current_A > limits.meter_current_A * (1.0 + 1e-9):
        text = (
            f"the meter's test current is {test_current_A:g} A; the limit is {limits.meter_current_A:g} A "
            "(limits.meter_current_A)"
        )
        raise Tripped("meter_current_limit", text, now_s)
