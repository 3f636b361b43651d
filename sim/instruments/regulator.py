"""The temperature controller inside an instrument: PID with ramped nominal value and anti-windup.

    e_k = nominal_k - T_k
    u_k = Kp (e_k + 1/Ti sum e dt) - Kp Td dT/dt          in % of the current limit, kept within +-100
    nominal_k moves towards the target by at most ramp dt a step

Kp in %/degC, Ti and Td in s, as parameters 3010 to 3012 of the Meerstetter family name them (5136AL). The
maker's law is not published; this is the textbook one, derivative on the measurement with a first-order
filter whose pole is the damping (3013), integrator held while the output is at its bound and the error
would drive it further.
"""

from __future__ import annotations

from math import copysign, isnan, nan


class Regulator:
    """State between two ticks; gains are given with each step, so they can change at any time."""

    def __init__(self) -> None:
        self.nominal_degC = nan
        self.output_percent = 0.0
        self._integral_percent = 0.0
        self._slope_K_per_s = 0.0
        self._last_degC = nan

    def start(self) -> None:
        """Forget everything: the next step ramps from the temperature it is given."""
        self.__init__()  # type: ignore[misc]

    def step(
        self,
        target_degC: float,
        temperature_degC: float,
        dt_s: float,
        *,
        ramp_K_per_s: float,
        gain_percent_per_K: float,
        integral_time_s: float,
        derivative_time_s: float,
        damping: float,
        lowest_percent: float = -100.0,
    ) -> float:
        """Output in % of the current limit, -100 (`lowest_percent`, 0 for a heater) to 100, positive heats."""
        if isnan(self.nominal_degC):
            self.nominal_degC = temperature_degC
        distance_K = target_degC - self.nominal_degC
        if ramp_K_per_s > 0.0 and abs(distance_K) > ramp_K_per_s * dt_s:
            self.nominal_degC += copysign(ramp_K_per_s * dt_s, distance_K)
        else:
            self.nominal_degC = target_degC
        if not isnan(self._last_degC):
            slope_K_per_s = (temperature_degC - self._last_degC) / dt_s
            self._slope_K_per_s += (1.0 - damping) * (slope_K_per_s - self._slope_K_per_s)
        self._last_degC = temperature_degC
        error_K = self.nominal_degC - temperature_degC
        increment = gain_percent_per_K * error_K * dt_s / integral_time_s if integral_time_s > 0.0 else 0.0
        fixed = gain_percent_per_K * (error_K - derivative_time_s * self._slope_K_per_s)
        wanted = fixed + self._integral_percent + increment
        output = min(100.0, max(lowest_percent, wanted))
        if wanted == output or (wanted > output) != (increment > 0.0):
            self._integral_percent = min(100.0, max(lowest_percent, self._integral_percent + increment))
        self.output_percent = output
        return output
