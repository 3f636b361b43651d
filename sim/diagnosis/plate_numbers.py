"""The plate's parameters with their intervals, and the doubts about them: ends of the search, values outside physics.

A Peltier module's figure of merit, ZT = S^2 T / (R_e K) = s^2 T / (r g), needs neither the heat capacity nor the unit
of the current. Bismuth telluride reaches about 1 at room temperature (H. J. Goldsmid, Introduction to
Thermoelectricity, Springer), and a plate loses heat in other ways besides, which makes it less.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from compensator.hysteresis.functions import KELVIN
from sim.diagnosis.result import Interval, PlateNumbers, rough
from sim.inference.covariance import NORMAL_95
from sim.inference.joint.likelihood import PLATE_NAMES, Fit
from sim.inference.plate.fit import constant_drive

FIXED_BY: Final = {
    "s": "steps of the current in both directions fix it",
    "r": "large currents in both directions fix it: Joule's heat is what both have in common",
    "g": "a rest without a current fixes it, several time constants of the plate long",
    "q": "steps of the drive fix it",
    "ambient_degC": "a rest without a current fixes it, until the temperature stands still",
}
LATE: Final = (  # of an input that changes, or it were none
    "it changes, and the plate does not answer as fast as if it heated the plate itself: its heat may come by way of a "
    "third body"
)
LOGARITHMIC: Final = ("s", "r", "g", "q")  # positive, with intervals as factors
ROOM_DEGC: Final = (5.0, 45.0)  # where people and instruments work: most makers' limits of operation
WIDE: Final = 3.0  # ratio of an interval's ends from which a parameter counts as not fixed
WIDE_K: Final = 15.0  # the same of a room: more than summer and winter differ by in most laboratories
MEANINGLESS: Final = 5.0  # half an interval in a logarithm: a factor of 150 to either side is no knowledge
MOST_ZT: Final = 3.0  # three times what modules reach: no module, whatever a fit gets wrong besides
MISSES_MUCH: Final = 1.5  # times the noise: an adequate plate model leaves 0.9 to 1.2


def plate_numbers(found_by: Fit) -> PlateNumbers | None:
    """Return the plate's numbers to simulate with, and the errors of a fit; None for a record without current."""
    fit, joint = found_by.for_simulation, found_by.joint
    if not joint.driven:
        return None
    x, errors = fit.at.x, found_by.covariance().standard_errors
    doubts = []
    noise = fit.metric.temperature.noise.white
    times = float(np.sqrt(np.mean(fit.at.residual_K**2))) / max(noise, joint.record.step_K)
    if times > MISSES_MUCH:
        text = f"the residual of the temperature is {rough(times)} times its noise"
        doubts.append(f"all parameters: {text}, so that the errors may be larger than these intervals")
    current = joint.record.current_A
    assert current is not None
    if constant := constant_drive(current[:-1], joint.kind):
        doubts.append(constant)
    found: dict[str, tuple[float, Interval | None]] = {}
    for k, unknown in enumerate(joint.unknowns):
        name = PLATE_NAMES.get(
            unknown.name, f"inputs.{unknown.name.removeprefix('input.')}" if "input." in unknown.name else ""
        )
        if not name:
            continue
        value = float(x[k])
        ci = _interval(unknown.name, value, NORMAL_95 * float(errors[k]))
        found[name] = (value, ci)
        doubt = _doubt(name, value, ci)
        if doubt is not None:
            doubts.append(f"{doubt}; {FIXED_BY.get(unknown.name, 'larger changes of it fix it')}")
    if joint.kind == "peltier":
        s, r, g, _, ambient, *_ = joint.plate_numbers(x)
        merit = float(s * s * (ambient + KELVIN) / max(r * g, 1e-300))
        if merit > MOST_ZT:
            text = f"a figure of merit ZT of {merit:.2g} at room temperature, where modules reach 1"
            doubts.append(f"{text}: Seebeck, resistance and conductance do not fit one another; {FIXED_BY['r']}")
    return PlateNumbers(joint.kind, found, tuple(doubts))


def _interval(unknown: str, value: float, half: float) -> Interval | None:
    """Return the 95 % interval; None where nothing is known of the number."""
    if unknown in LOGARITHMIC:
        share = half / max(abs(value), 1e-300)
        return None if not share < MEANINGLESS else (value * math.exp(-share), value * math.exp(share))
    if unknown == "ambient_degC" and not half < 0.5 * (ROOM_DEGC[1] - ROOM_DEGC[0]):
        return None
    return (value - half, value + half) if math.isfinite(half) else None


def _doubt(name: str, value: float, ci: Interval | None) -> str | None:
    """Return the doubt about a value that is outside physics, or whose interval is too wide; else None."""
    if name == "ambient_degC":
        if not ROOM_DEGC[0] <= value <= ROOM_DEGC[1]:
            return f"{name}: {value:.0f} degC is no room's temperature"
        if ci is None:
            return f"{name}: not known"
        return f"{name}: known to within {0.5 * (ci[1] - ci[0]):.0f} K only" if ci[1] - ci[0] > WIDE_K else None
    if name.endswith("slope_per_K"):  # the prior knows it, whatever the record shows
        return None
    if ci is None:
        return f"{name}: not known"
    if ci[0] <= 0.0:
        return f"{name}: as good as 0; {LATE}"
    factor = math.sqrt(ci[1] / ci[0])
    return f"{name}: known to within a factor of {rough(factor)} only" if factor > math.sqrt(WIDE) else None
