"""Polarity, before anything else is sent: does a small current heat when it should?

rest    no current for a moment: how the temperature drifts by itself
pulse   a share of the current limit (limits.polarity_share), twice as much where that decides nothing; as soon as the
        temperature has left its drift clearly, the way that it left says it. Hot plates are cooled instead.
again   where it left the wrong way, the opposite current: polarity is wrong only if that moves it the wrong way too;
        a plate that still drifts from what was before (a long delay, a slow thermometer) goes one way with either
"""

from __future__ import annotations

import math

import numpy as np

from rig.files.configuration import Configuration
from rig.loop import Decision, Loop
from rig.outcome import Tripped

REST_S, FIRST_S, SECOND_S = 1.5, 10.0, 20.0
FEWEST = 5  # readings at rest
CLEARLY_K, STEPS, SIGMAS = 0.4, 3.0, 6.0
CURVED_PER_S = 0.015  # a drift's own change of rate, over the drift: a plate's time constant is a minute or more
NEAR_LIMIT_K = 5.0
TRIALS = 3


class PolarityPulse:
    """The policy of the phase. current_A: of the pulse's first part, its sign the way that it is to go.

    left_K: by how much the temperature has left its drift in that way, nan before that is clear.
    """

    def __init__(self, current_A: float, limit_A: float, period_s: float) -> None:
        self.current_A = current_A
        self.left_K = math.nan
        self.rest_s = max(REST_S, FEWEST * period_s)
        self._strong_A = math.copysign(min(2.0 * abs(current_A), limit_A), current_A)
        self._times: list[float] = []
        self._values: list[float] = []
        self._drift: tuple[float, float, float] | None = None

    @property
    def duration_s(self) -> float:
        """Longest that it takes, s."""
        return self.rest_s + FIRST_S + SECOND_S

    def decide(self, time_s: float, temperature_degC: float, output: float) -> Decision:
        if not math.isnan(temperature_degC):
            self._times.append(time_s)
            self._values.append(temperature_degC)
        if time_s < self.rest_s - 1e-9 or len(self._values) < FEWEST:
            return Decision(0.0)
        if self._drift is None:
            self._drift = self._fit()
        if self._clearly():
            return Decision(0.0, done=True)
        return Decision(self.current_A if time_s < self.rest_s + FIRST_S else self._strong_A)

    def _fit(self) -> tuple[float, float, float]:
        """The drift at rest, a line: value at its end, slope; and how far readings scatter about it."""
        times, values = np.array(self._times) - self._times[-1], np.array(self._values)
        slope, value = np.polyfit(times, values, 1)
        return float(value), float(slope), float(np.std(values - (value + slope * times)))

    def _clearly(self) -> bool:
        assert self._drift is not None
        value, slope, scatter_K = self._drift
        age_s = self._times[-1] - self.rest_s
        left_K = self._values[-1] - (value + slope * age_s)
        steps = np.abs(np.diff(self._values))
        step_K = float(np.min(steps[steps > 0.0], initial=math.inf))
        coarse_K = STEPS * step_K if math.isfinite(step_K) else 0.0
        if abs(left_K) < max(CLEARLY_K, coarse_K, SIGMAS * scatter_K) + CURVED_PER_S * abs(slope) * age_s**2:
            return False
        self.left_K = math.copysign(1.0, self.current_A) * left_K
        return True


def check_polarity(loop: Loop, configuration: Configuration, period_s: float, cools: bool = True) -> None:
    """Pulse, and judge. cools: whether the plate can. Raises Tripped("polarity") or Tripped("no_response")."""
    limits = configuration.limits
    if limits.polarity_share == 0.0 or not loop.bench.controller.commands_current:
        loop.folder.event(loop.elapsed_s(), "polarity", "not checked")
        return
    now = loop.bench.controller.read_temperature()
    hot = cools and now.is_number and now.value > limits.temperature_degC[1] - NEAR_LIMIT_K
    current_A = (-1.0 if hot else 1.0) * limits.polarity_share * limits.current_A
    said = 0.0
    for _ in range(TRIALS):
        pulse = _pulsed(loop, current_A, limits.current_A, period_s)
        if pulse.left_K > 0.0:
            text = f"{current_A:g} A {'heats' if current_A > 0.0 else 'cools'}"
            loop.folder.event(loop.elapsed_s(), "polarity", text, moved_K=pulse.left_K)
            return
        said = pulse.left_K
        if not cools or _pulsed(loop, -current_A, limits.current_A, period_s).left_K < 0.0:
            break  # either current moves it the wrong way; otherwise it drifts by itself, and has settled some more
    text = (
        f"{current_A:g} A should {'heat' if current_A > 0.0 else 'cool'}, and moved the temperature by "
        f"{abs(said):.2f} K the other way, {-current_A:g} A as well: the Peltier is connected with the wrong polarity"
    )
    raise Tripped("polarity", text, loop.elapsed_s())


def _pulsed(loop: Loop, current_A: float, limit_A: float, period_s: float) -> PolarityPulse:
    """One pulse. Raises Tripped("no_response")."""
    pulse = PolarityPulse(current_A, limit_A, period_s)
    loop.phase("polarity", pulse, pulse.duration_s, period_s)
    if math.isnan(pulse.left_K):
        text = (
            f"{current_A:g} A, then twice that, for {FIRST_S + SECOND_S:g} s did not "
            f"{'heat' if current_A > 0.0 else 'cool'} the plate: is the Peltier connected, and the thermometer on it?"
        )
        raise Tripped("no_response", text, loop.elapsed_s())
    return pulse
