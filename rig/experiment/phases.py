"""The phases of an experiment before it begins, in order, each with the seconds that it will take.

What is not known yet is guessed: the rates that the plate allows, where the transition lies. A phase gives its own
length when it begins, which replaces the guess.
"""

from __future__ import annotations

from itertools import pairwise

from compensator.thermal.plate import PlateModel
from rig.config.configuration import Configuration
from rig.config.model_file import Model
from rig.config.target import Target
from rig.control.decision import Phases
from rig.experiment.calibration import PULSE_S, calibration_range, fitted_and_checked, minor_turning_points
from rig.experiment.feasibility import OWN_POLICY

POLARITY_S = 5.0  # of a plate whose thermometer answers at once
ROOM_DEGC = 25.0
USUAL_K_PER_S = 1.0  # of a plate that nobody has measured yet
TRANSITION_SHARE = 0.4  # of the range that a calibration goes through


def still_to_come(phases: Phases, name: str) -> Phases:
    """Return the phases that are expected after the one of this name, which begins; all if none has this name."""
    names = [expected for expected, _ in phases]
    return phases[names.index(name) + 1 :] if name in names else phases


def expected_calibration(configuration: Configuration) -> Phases:
    """Return the phases of a calibration, with their seconds."""
    c = configuration.calibration
    low, high = calibration_range(configuration)
    rate, width = c.rate_K_per_s, TRANSITION_SHARE * (high - low)
    middle = 0.5 * (low + high)
    span = c.transition_degC or (middle - 0.5 * width, middle + 0.5 * width)
    fitted, checked = fitted_and_checked(minor_turning_points(span, (low, high), c.minor_loops, c.seed))

    def along(points: list[float]) -> float:
        return sum(abs(b - a) / rate + c.dwell_s for a, b in pairwise(points)) + c.dwell_s

    return [
        ("polarity", POLARITY_S),
        *[("pulse", seconds) for seconds in (2.0, PULSE_S, PULSE_S, PULSE_S, PULSE_S)],
        ("condition", along([ROOM_DEGC, high])),
        ("major", along([high, low, high, low])),
        ("minor", along([low, *fitted])),
        ("check", along([fitted[-1], *checked])),
    ]


def expected_run(configuration: Configuration, target: Target, model: Model | None) -> Phases:
    """Return the phases of a run: a calibration if there is no model, then each law."""
    e = configuration.experiment
    plate = model.plate if model is not None else None
    if e.kind not in ("track_resistance", "track_output"):
        by_a_law = e.law != "instrument_pid" and e.kind not in OWN_POLICY
        approach = [("approach", e.settle_s)] if by_a_law else []
        return [("polarity", POLARITY_S), *approach, ("profile", target.duration_s)]
    low, high = calibration_range(configuration)
    rate = _rate(plate, configuration, high)
    way_s = 0.5 * (high - low) / rate
    first = [("polarity", POLARITY_S)] if model is not None else expected_calibration(configuration)
    each = [("condition", way_s), ("approach", way_s + e.settle_s)] if e.memory == "condition" else []
    each = [*each, ("settle", e.settle_s)]
    runs = len(e.laws) + e.repeat - 1
    return [*first, *[phase for _ in range(runs) for phase in (*each, ("track", target.duration_s))]]


def _rate(plate: PlateModel | None, configuration: Configuration, high_degC: float) -> float:
    """Return the rate of the plate on the way to its conditioning and back (K/s)."""
    if plate is None:
        return USUAL_K_PER_S
    cool, heat = plate.rate_range_K_per_s(high_degC, configuration.limits.current_A)
    return max(configuration.control.rate_share * min(heat, abs(cool)), 0.01)
