"""The pulses at the start of a calibration: what they tell of plate and thermometer, and whether it can be believed.

One current of each sign (a heater: two sizes), each with a rest, bounded by what the first plate says of the heat that
has not shown yet. The plate that answers to them has to be one, and the same as the one of the polarity pulse: a
thermometer that came off in between would be taken for another plate.
"""

from __future__ import annotations

import numpy as np

from compensator.thermal.plate import Kind
from rig.config.configuration import Configuration
from rig.config.target import Target
from rig.control.loop import Loop
from rig.control.policies import CurrentProfile
from rig.core.outcome import Tripped
from rig.drivers.controller import cools
from rig.records.run_folder import RunFolder
from rig.safety.first_plate import OF_A_PULSE, OF_PULSES, KnownPlate
from sim.inference.plate.fit import identify_plate

PULSE_SHARE = 0.5  # of the current limit, at most
PULSE_S, PULSE_K = 8.0, 10.0  # how long, and by how much a pulse is to heat
LONG_LAG_S = 5.0  # beyond it, pulses do not tell a thermometer's lag from the plate's own time constant
OTHER_PLATE = 1.7  # times the gain of the first pulse, or one over that: 1.5 apart at most, in steps of 0.25 K
OTHER_PLATE_BEHIND = 4.0  # behind a long lag, which one pulse hardly tells from a low gain
OTHER_LAG_S, OTHER_LAG = 3.0, 2.0
UNLIKE_A_PLATE = 0.03  # of the pulses' span: effects of the catalogue leave less than 0.02
LEAST_RISE_K = 0.3  # that a heating pulse must give


def heat_by_pulses(loop: Loop, configuration: Configuration) -> None:
    """Pulses of current of both signs, no larger than what the first plate may take unseen. Raises Tripped where a
    heating current does not heat."""
    known = loop.watch.plate.known
    behind_s = known.behind_s if known is not None else 0.0
    current = PULSE_SHARE * configuration.limits.current_A
    low, high = configuration.limits.temperature_degC
    if known is not None:
        at_room = known.plate.ambient_degC  # where nothing is lost
        current = min(current, current * PULSE_K / (PULSE_S * known.plate.rate_K_per_s(at_room, current)))
    inset = 0.05 * (high - low)  # a pulse ends before the interlock has to end it
    period = configuration.calibration.period_s
    rest_s = PULSE_S + behind_s
    other = -current if cools(loop.bench.controller) else 0.5 * current
    steps = [(0.0, 2.0), (current, PULSE_S), (0.0, rest_s), (other, PULSE_S), (0.0, rest_s)]
    before = len(loop.folder.rows)
    for k, (value, length) in enumerate(steps):
        profile = Target("current", np.array([0.0, length]), np.array([value, value]))
        loop.phase("pulse", CurrentProfile(profile, low + inset, high - inset), length, period)
        if k == 2:
            rise = loop.folder.column("temperature_degC")[before:]
            change = float(np.nanmax(rise) - rise[np.isfinite(rise)][0])
            if not change > LEAST_RISE_K:
                text = (
                    f"{current:g} A for {PULSE_S:g} s changed the temperature by {change:+.2f} K; expected a rise of "
                    f"more than {LEAST_RISE_K:g} K: is the Peltier connected, and with the right polarity?"
                )
                raise Tripped("polarity", text, loop.elapsed_s())


def plate_of_pulses(folder: RunFolder, kind: Kind, delay_s: float) -> KnownPlate:
    """Plate and the thermometer's lag from all rows so far; the first pulse has told by how much currents come late.

    Raises Tripped where no plate answers as the readings do.
    """
    time, degC, current = (folder.column(name) for name in ("time_s", "temperature_degC", "current_A"))
    acting = np.searchsorted(time, time - delay_s + 1e-6, "right") - 1
    acted_A = np.where(acting >= 0, current[np.maximum(acting, 0)], 0.0)
    fit = identify_plate(time, degC, acted_A, kind=kind, lag=True, slopes=False)  # two pulses span some kelvin
    span_K = float(np.nanmax(degC) - np.nanmin(degC))
    steps = np.abs(np.diff(degC[np.isfinite(degC)]))
    step_K = float(np.min(steps[steps > 0.0], initial=0.5))
    if fit.rmse_K > UNLIKE_A_PLATE * span_K + 3.0 * fit.noise_K + step_K:
        text = (
            f"no plate answers to the pulses as the readings do: the best fit is off by {fit.rmse_K:.2f} K (RMS) over "
            f"{span_K:.1f} K: is the thermometer still on it?"
        )
        raise Tripped("other_plate", text, float(time[-1]))
    doubt = OF_PULSES if fit.lag_s < LONG_LAG_S else OF_A_PULSE
    return KnownPlate(fit.model, fit.lag_s, delay_s, doubt=doubt)


def check_same_plate(first: KnownPlate, now: KnownPlate, time_s: float) -> None:
    """Raises Tripped where the plate answers to the pulses in another way than to the first one: its thermometer may
    have come off in between, and the fit would take that for the plate."""
    if now.lag_s > OTHER_LAG_S + OTHER_LAG * first.behind_s:
        text = f"it shows a current {now.lag_s:.1f} s late now, {first.behind_s:.1f} s at the most at the first pulse"
        raise Tripped("other_plate", f"the thermometer is not as it was: {text}; is it still on the plate?", time_s)
    then, after = (p.plate.seebeck_over_capacity_per_A_s or p.plate.drive_over_capacity_K_per_s for p in (first, now))
    other = OTHER_PLATE if max(first.behind_s, now.behind_s) < LONG_LAG_S else OTHER_PLATE_BEHIND
    if not 1.0 / other < after / then < other:
        text = (
            f"the pulses of the calibration heat the plate {after / then:.2f} times as fast as the first one did: is "
            "the thermometer still on it?"
        )
        raise Tripped("other_plate", text, time_s)
