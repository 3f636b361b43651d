"""The plate and films of `_tracked_plant` with one effect on them, written apart from `sim`: Euler steps of `STEP_S`.

actuator_delay    the current acts delay_s later
heat_sink_warmup  C_s dT_s/dt = -S I T_s + R_e I^2 / 2 + G (T_p - T_s) - G_s (T_s - T_a); plate: G (T_p - T_s)
sensor_lag        tau dT_th/dt = T_p - T_th
film_lag          tau dT_f/dt = T_p - T_f
self_heating      T_f = T_p + theta I_m^2 R, R of the step before (the film answers within `STEP_S`)
film_drift        T_f = T_p + kappa t, t since the plant began
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from benchmarks._own_plant import STEP_S
from benchmarks._tracked_plant import Plate, TrackedPlant, TrueFilm


@dataclass(frozen=True)
class Hidden:
    """What is hidden: 0 (a sink: an infinite capacity) where nothing is."""

    delay_s: float = 0.0
    sink_capacity_ratio: float = 0.0
    sink_conductance_ratio_per_s: float = 0.0
    sensor_lag_s: float = 0.0
    film_lag_s: float = 0.0
    theta_K_per_W: float = 0.0
    film_drift_K_per_h: float = 0.0


class EffectPlant(TrackedPlant):
    """A tracked plant with an effect. degC: the plate's; the course has the film's own resistance."""

    def __init__(
        self, plate: Plate, film: TrueFilm, seed: int, start_s: float, hidden: Hidden, noise: float = 1.0
    ) -> None:
        super().__init__(plate, film, seed, start_s, noise)
        self.hidden = hidden
        self.sink_degC = self.shown_degC = self.lagged_degC = plate.ambient_degC
        self._begin_s = start_s
        self._commanded: deque[tuple[float, float]] = deque()

    def set_current_A(self, current_A: float) -> None:
        if self.hidden.delay_s == 0.0:
            self.current_A = current_A
        else:
            self._commanded.append((self.time_s + self.hidden.delay_s, current_A))

    def sink_temperature_degC(self) -> float:
        return self.plate.ambient_degC  # of a sink's thermometer: there is none

    def read_temperature_degC(self) -> float:
        plate_degC, self.degC = self.degC, self.shown_degC
        try:
            return super().read_temperature_degC()
        finally:
            self.degC = plate_degC

    def _film_degC(self) -> float:
        """What drift and power make of the lagged plate."""
        h = self.hidden
        degC = self.lagged_degC + h.film_drift_K_per_h * (self.time_s - self._begin_s) / 3600.0
        return degC + h.theta_K_per_W * self.test_current_A**2 * 10.0**self.log_ohm

    def _run(self, until_s: float) -> None:
        p, h = self.plate, self.hidden
        while self.time_s < until_s - 1e-12:
            if self._commanded and self._commanded[0][0] <= self.time_s + 1e-12:
                self.current_A = self._commanded.popleft()[1]
            dt = min(STEP_S, until_s - self.time_s)
            if self._commanded:
                dt = min(dt, max(self._commanded[0][0] - self.time_s, 1e-9))
            joule = p.joule_W(self.degC, self.current_A)
            sink = self.sink_degC if h.sink_capacity_ratio else p.ambient_degC
            heat = p.pumped_W(self.degC, self.current_A) + joule - p.conductance * (self.degC - sink)
            if h.sink_capacity_ratio:
                taken = -p.pumped_W(sink, self.current_A) + joule + p.conductance * (self.degC - sink)
                lost = h.sink_conductance_ratio_per_s * p.capacity * (sink - p.ambient_degC)
                self.sink_degC += dt * (taken - lost) / (h.sink_capacity_ratio * p.capacity)
            if h.sensor_lag_s:
                self.shown_degC += dt * (self.degC - self.shown_degC) / h.sensor_lag_s
            if h.film_lag_s:
                self.lagged_degC += dt * (self.degC - self.lagged_degC) / h.film_lag_s
            self.degC += dt * heat / p.capacity
            if not h.sensor_lag_s:
                self.shown_degC = self.degC
            if not h.film_lag_s:
                self.lagged_degC = self.degC
            self.time_s += dt
            self._heat_film()
            self.course.append((self.time_s, self.degC, self.log_ohm))
        self.time_s = max(self.time_s, until_s)

    def _heat_film(self) -> None:
        """The film to its temperature; in small steps where its own resistance, which falls as it warms, decides it."""
        if not self.hidden.theta_K_per_W:
            self.log_ohm = self.film.log_ohm(self._film_degC())
            return
        self.log_ohm = self.film.log_ohm(self._film_degC())
