"""The temperature controller inside an instrument: a PID law with ramped nominal value, ten times a second.

    e_k = nominal_k - T_k
    u_k = Kp (e_k + 1/Ti sum e dt) - Kp Td dT/dt          in % of the current limit, kept within +-100
    nominal_k moves towards the target by at most ramp dt a step

Kp in %/degC, Ti and Td in s, as parameters 3010 to 3012 of the Meerstetter family (5136AL). No maker publishes the law;
this is the textbook one. The derivative acts on the measurement, behind a first-order filter whose pole is the damping
(3013). The integrator holds while the output is at its bound and the error would drive it further.
"""

from __future__ import annotations

from math import copysign, isnan, nan

from sim.instruments.instrument import Plant

TICK_S = 0.1  # of the control loops (no maker says; assumed)


class Regulator:
    """State of the law between two steps; gains are given with each step, so that they can change at any time."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget everything: the next step ramps from the temperature that it is given."""
        self.nominal_degC = nan
        self.output_percent = 0.0
        self._integral_percent = 0.0
        self._slope_K_per_s = 0.0
        self._last_degC = nan

    def step(
        self,
        target_degC: float,
        temperature_degC: float,
        *,
        gain_percent_per_K: float,
        integral_time_s: float,
        derivative_time_s: float,
        ramp_K_per_s: float = 0.0,
        damping: float = 0.3,
        lowest_percent: float = -100.0,
    ) -> float:
        """Return the output after `TICK_S`, `lowest_percent` (0 for a heater) to 100 % of the current limit."""
        if isnan(self.nominal_degC):
            self.nominal_degC = temperature_degC
        distance_K = target_degC - self.nominal_degC
        if ramp_K_per_s > 0.0 and abs(distance_K) > ramp_K_per_s * TICK_S:
            self.nominal_degC += copysign(ramp_K_per_s * TICK_S, distance_K)
        else:
            self.nominal_degC = target_degC
        if not isnan(self._last_degC):
            slope_K_per_s = (temperature_degC - self._last_degC) / TICK_S
            self._slope_K_per_s += (1.0 - damping) * (slope_K_per_s - self._slope_K_per_s)
        self._last_degC = temperature_degC
        error_K = self.nominal_degC - temperature_degC
        increment = gain_percent_per_K * error_K * TICK_S / integral_time_s if integral_time_s > 0.0 else 0.0
        fixed = gain_percent_per_K * (error_K - derivative_time_s * self._slope_K_per_s)
        wanted = fixed + self._integral_percent + increment
        output = min(100.0, max(lowest_percent, wanted))
        if wanted == output or (wanted > output) != (increment > 0.0):
            self._integral_percent = min(100.0, max(lowest_percent, self._integral_percent + increment))
        self.output_percent = output
        return output


class Ticking:
    """Part of an emulated controller that runs its control loop every `TICK_S` of the plant's time."""

    _plant: Plant
    _now_s: float

    def _start_ticking(self, start_s: float) -> None:
        self._ticks, self._start_s = 0, start_s
        self._plant.schedule(start_s + TICK_S, self._tick)

    def _tick(self, time_s: float) -> None:
        self._ticks += 1
        self._now_s = time_s
        self._plant.schedule(self._start_s + (self._ticks + 1) * TICK_S, self._tick)
        self._control()

    def _control(self) -> None:
        """Measure, judge, and drive the output, at `_now_s`."""
        raise NotImplementedError
