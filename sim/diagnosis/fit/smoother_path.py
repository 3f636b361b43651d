"""A path that drives the film, smoothed without delay: what a lag takes off it that is noise of the path, and no lag.

A path that was measured, or corrected by what was measured, has the thermometer's noise in it, and a current that was
sampled too rarely leaves more. The film's readings have none of it: any filter on the way is then better than none, and
a lag with a skew that takes its delay back is one. A first-order lag forwards and then backwards has no delay; with a
time constant of 1 / sqrt(2) of another lag's it takes as much off what is slow beside both: 1 - w^2 tau^2 / 2 of a
frequency w, either way.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from sim.diagnosis.fit.path_estimate import straight_path
from sim.effects.lag import first_order_lag
from sim.model.plate_path import PlatePath

AS_SMOOTH: Final = 1.0 / math.sqrt(2.0)  # of a lag's time constant: as above


def smoothed(path: PlatePath, tau_s: float) -> PlatePath:
    """The path through a lag forwards and backwards, straight between its nodes."""
    time, later, out = path.time_s, np.empty(path.time_s.size), np.empty(path.time_s.size)
    first_order_lag(tau_s, time, path.plate_degC, np.array([math.nan]), later)
    first_order_lag(tau_s, time[-1] - time[::-1], later[::-1].copy(), np.array([math.nan]), out)
    return replace(straight_path(time, np.ascontiguousarray(out[::-1])), turning_s=path.turning_s)
