"""The plate's parameters with their intervals, and where they cannot be: at the end of the search, outside physics.

A Peltier module's figure of merit, ZT = S^2 T / (R_e K) = s^2 T / (r g), needs neither the heat capacity nor the unit
of the current. Bismuth telluride reaches about 1 at room temperature (H. J. Goldsmid, Introduction to
Thermoelectricity, Springer), and a plate loses heat in other ways besides, which makes it less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from compensator.hysteresis.functions import KELVIN
from compensator.thermal.plate import Kind
from sim.diagnosis.data.noise_model import root_mean_square
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.fit.unknowns import Unknown
from sim.diagnosis.report.intervals import MEANINGLESS, first_deviations
from sim.diagnosis.search.chain import Chain
from sim.inference.covariance import NORMAL_95
from sim.inference.plate.notes import constant_drive

Interval = tuple[float, float] | None
NAMES: Final = {  # of the fit's unknowns, as a model file has them
    "s": "seebeck_over_capacity_per_A_s",
    "r": "resistance_over_capacity_K_per_A2_s",
    "g": "conductance_over_capacity_per_s",
    "q": "drive_over_capacity_K_per_s",
    "ambient_degC": "ambient_degC",
}
FIXED_BY: Final = {
    "s": "steps of the current in both directions fix it",
    "r": "large currents in both directions fix it: Joule's heat is what both have in common",
    "g": "a rest without a current fixes it, several time constants of the plate long",
    "q": "steps of the drive fix it",
    "ambient_degC": "a rest without a current fixes it, until the temperature stands still",
}
LATE: Final = (  # of an input that changes, or it were none
    "it changes, and the plate does not answer as fast as if it heated the plate itself: "
    "its heat may come by way of a third body"
)
ROOM_DEGC: Final = (5.0, 45.0)  # where people and instruments work: most makers' limits of operation
WIDE: Final = 3.0  # ratio of an interval's ends from which a parameter counts as not fixed
WIDE_K: Final = 15.0  # the same of a room: more than summer and winter differ by in most laboratories
MOST_ZT: Final = 3.0  # three times what modules reach: no module, whatever a fit gets wrong besides
MISSES_MUCH: Final = 1.5  # times the noise: a plate that is understood leaves 0.9 to 1.2
AT_THE_END: Final = 1e-3  # on the fit's scale: a thousandth of the value, or 0.01 K


@dataclass(frozen=True)
class PlateNumbers:
    """kind; parameters by the names of a model file, with their 95 % intervals, None where an interval has no meaning;
    doubts, a line each, with what an experiment would have to have."""

    kind: str
    parameters: dict[str, tuple[float, Interval]]
    doubts: list[str]

    def document(self) -> dict[str, Any]:
        """In `peltier-diagnosis/1`."""
        values = {
            name: {"value": value, "ci95": None if ci is None else list(ci)}
            for name, (value, ci) in self.parameters.items()
        }
        return {"kind": self.kind, "parameters": values, "doubts": self.doubts}


def plate_numbers(chain: Chain, names: frozenset[str]) -> PlateNumbers | None:
    """Of the fit with these effects; None for a record without current."""
    fit = chain.fits(names)[0]
    deviations = first_deviations(chain, names)
    if fit is None or deviations is None:
        return None
    assert chain.first is not None
    p, left = fit.parameters, root_mean_square(chain.first.channel.residual(fit))
    found: dict[str, tuple[float, Interval]] = {}
    doubts = []
    if left > MISSES_MUCH:
        text = f"the plate leaves {rough(left)} times the noise of the temperature"
        doubts.append(f"every number: {text}, and what it lacks may have moved them by more than these intervals")
    assert chain.record.current_A is not None
    kind: Kind = "heater" if p.kind == "heater" else "peltier"
    if constant := constant_drive(chain.record.current_A[:-1], kind):
        doubts.append(constant)
    for unknown, x, deviation in zip(p.base, p.x.tolist(), deviations.tolist(), strict=False):
        half = min(NORMAL_95 * deviation, 1e3)  # below what exp overflows at
        name = NAMES.get(unknown.name, unknown.name)
        ci = None if half > _farthest(unknown) else (unknown.outside(x - half), unknown.outside(x + half))
        value = unknown.outside(x)
        found[name] = (value, ci)
        lowest = x < unknown.low + AT_THE_END
        end = lowest or x > unknown.high - AT_THE_END
        doubt = f"{name}: {value:.3g} is the end of what is looked for" if end else _doubt(name, value, ci)
        if doubt is not None:
            fixed_by = FIXED_BY.get(unknown.name, LATE if lowest else "larger changes of it fix it")
            doubts.append(f"{doubt}; {fixed_by}")
    if p.kind == "peltier":
        s, r, g, _, ambient = p.plate()
        merit = float(s * s * (ambient + KELVIN) / (r * g))
        if merit > MOST_ZT:
            text = f"a figure of merit ZT of {merit:.2g} at room temperature, where modules reach 1"
            doubts.append(f"{text}: Seebeck, resistance and conductance do not fit one another; {FIXED_BY['r']}")
    return PlateNumbers(p.kind, found, doubts)


def _farthest(unknown: Unknown) -> float:
    """Half an interval, on the fit's scale, beyond which nothing is known of the number: of a room, from the coldest to
    the warmest that there are."""
    return MEANINGLESS if unknown.log else unknown.inside(0.5 * (ROOM_DEGC[1] - ROOM_DEGC[0]))


def _doubt(name: str, value: float, ci: Interval) -> str | None:
    """Where a value is outside physics, or its interval too wide to know it."""
    if name == "ambient_degC":
        if not ROOM_DEGC[0] <= value <= ROOM_DEGC[1]:
            return f"{name}: a room at {value:.0f} degC is none"
        if ci is None:
            return f"{name}: not known"
        return f"{name}: known to within {0.5 * (ci[1] - ci[0]):.0f} K only" if ci[1] - ci[0] > WIDE_K else None
    if ci is None:
        return f"{name}: not known"
    factor = math.sqrt(ci[1] / ci[0])
    return f"{name}: known to within a factor of {rough(factor)} only" if factor > math.sqrt(WIDE) else None
