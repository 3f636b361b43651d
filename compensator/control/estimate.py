"""What the law takes for the plate's temperature and for the error of the film model, out of noisy readings.

temperature   the plate model's prediction and a heating rate that it does not know of, corrected by the reading: the
              alpha-beta filter, whose two gains follow from the reading's noise and from how fast unknown heat changes.
              P. R. Kalata, IEEE Trans. Aerosp. Electron. Syst. AES-20 (1984) 174: tracking index, eqs (14), (17)
disturbance   reading minus film model, as a Kalman filter knows it: the film model's error is a random walk along the
              course of the output (a film that stands still does not change its model's error, one that moves by
              `LENGTH` changes it by about `model_error`) and creeps a little in time
model error   from how much the disturbance has changed over each `LENGTH` of the course, less what is noise of it
noise         of both readings, from their second differences: white noise on a smooth course

So nothing of this has to be told: a model that is exact is believed more and more, and one that is off is followed.
"""

from __future__ import annotations

import math
from math import nan
from typing import Final, NamedTuple

from numba import njit

from compensator.hysteresis.functions import Array

UNSTEADY_K_PER_S2: Final = 0.003  # of unknown heat, a sink, a draught: from 0.001 to 0.03 hardly anything changes
LENGTH: Final = 0.05  # of the output's course, in its unit: about a fifth of the width of one operator of a film
CREEP_PER_ROOT_S: Final = 3e-5  # 0.0002 in a minute, 0.002 in an hour: a film that drifts by 0.01 K an hour
FEW, MANY = 3.0, 20.0  # lengths that the first guess of the model error counts for, and that count at most
LEAST_ERROR: Final = 1e-4
NOISE_FIRST, NOISE_MANY = 20.0, 300.0  # the same, of readings
TINY: Final = 1e-12


class Estimate(NamedTuple):
    """What is known at a step beyond temperature and disturbance.

    drift_K_per_s: heating that the plate model does not know of. doubt: variance of the disturbance. noise_K2, noise2:
    variances of the two readings. model_error2: of the film model, along LENGTH. The two readings before (degC,
    output), how many have come, the output's course since its mark, the disturbance there, how many lengths have come.
    toward: sign of the output's last move; moved: the move that the last step planned. The order is that of the places
    below.
    """

    drift_K_per_s: float = 0.0
    doubt: float = 1e-4
    noise_K2: float = 1e-4
    noise2: float = 4e-6
    model_error2: float = 9e-6
    last_degC: float = nan
    before_degC: float = nan
    last: float = nan
    before: float = nan
    readings_degC: float = 0.0
    readings: float = 0.0
    course: float = 0.0
    mark: float = nan
    lengths: float = 0.0
    toward: float = 0.0
    moved: float = 0.0


# places in a state's numbers, from FIRST on
FIRST: Final = 12
DRIFT, DOUBT, NOISE_K2, NOISE2, MODEL_ERROR2, LAST_DEGC, BEFORE_DEGC, LAST, BEFORE = range(FIRST, FIRST + 9)
READINGS_DEGC, READINGS, COURSE, MARK, LENGTHS, TOWARD, MOVED = range(FIRST + 9, FIRST + 16)


@njit(cache=True)
def learn_noise(state: Array, variance: int, count: int, last: int, before: int, value: float) -> None:
    """One more reading: its noise's variance from its second difference, over some hundred readings."""
    if not math.isnan(state[before]):
        bend = value - 2.0 * state[last] + state[before]
        state[count] = min(state[count] + 1.0, NOISE_MANY)
        state[variance] += (bend * bend / 6.0 - state[variance]) / (state[count] + NOISE_FIRST)
    state[before], state[last] = state[last], value


@njit(cache=True)
def corrected_temperature(state: Array, predicted_degC: float, reading_degC: float, period_s: float) -> float:
    """The temperature (degC) after a reading; the drift is in the prediction, and is learned."""
    learn_noise(state, NOISE_K2, READINGS_DEGC, LAST_DEGC, BEFORE_DEGC, reading_degC)
    index = UNSTEADY_K_PER_S2 * period_s**2 / math.sqrt(state[NOISE_K2] + TINY)
    root = 0.25 * (4.0 + index - math.sqrt(8.0 * index + index * index))
    alpha = 1.0 - root * root
    beta = 2.0 * (2.0 - alpha) - 4.0 * math.sqrt(1.0 - alpha)
    innovation = reading_degC - predicted_degC
    state[DRIFT] += beta / period_s * innovation
    return predicted_degC + alpha * innovation


@njit(cache=True)
def corrected_disturbance(state: Array, disturbance: float, off: float, output: float, period_s: float) -> float:
    """The disturbance after a reading that is `off` the film model; output: the reading itself, for its noise."""
    learn_noise(state, NOISE2, READINGS, LAST, BEFORE, output)
    walked = abs(state[MOVED])
    state[DOUBT] += 2.0 * state[MODEL_ERROR2] * walked / LENGTH + CREEP_PER_ROOT_S**2 * period_s
    share = state[DOUBT] / (state[DOUBT] + state[NOISE2] + TINY)
    found: float = disturbance + share * (off - disturbance)
    state[DOUBT] *= 1.0 - share
    state[COURSE] += walked
    if state[COURSE] >= LENGTH:
        if not math.isnan(state[MARK]):
            change2 = 0.5 * (found - state[MARK]) ** 2 * LENGTH / state[COURSE]
            sample = max(change2 - state[DOUBT], LEAST_ERROR**2)
            state[MODEL_ERROR2] += (sample - state[MODEL_ERROR2]) / (min(state[LENGTHS], MANY) + FEW)
            state[LENGTHS] += 1.0
        state[COURSE], state[MARK] = 0.0, found
    return found
