"""What the best possible test could see: the likelihood ratio with the true model, everything else free.

The record without noise is linearized in all that a fit has free (plate, first temperature, every parameter of the
film, parameters of the other effects). What an effect changes, over the noise, is projected off these directions; half
the square of what is left is the expected log-likelihood ratio. An effect may move the film's temperature by many times
what can be seen of it once plate and film follow: so the film is asked what a small share of that move changes, or its
curvature would pass for evidence. The smallest size that can be found is the one where
that is half the 99.9 % quantile of chi-square with as many degrees of freedom as the effect has parameters: a test with
one false alarm in a thousand then finds it half of the time.

Nobody who diagnoses a film outside the class knows the form of its density. There the test has, besides, a relay at
every place of the Preisach plane, each uncertain by as much as the mean relay switches, and neighbours together: a
density is smooth. What such relays can imitate is the film's own shape as far as anybody can tell.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tests.sim.diagnosis.truth.films import Film
from tests.sim.diagnosis.truth.hysteresis import PLAY, PREISACH
from tests.sim.diagnosis.truth.rig import Effects, Rig, Schedule, Thermal, log_ohm, thermal

Array = NDArray[np.float64]
COARSE_S = 0.125
PLATE_STEPS = (("a", 1e-4), ("b", 1e-3), ("g", 1e-4), ("ambient_degC", 1e-4), ("start_degC", 1e-4))
FILM_EFFECTS = {
    "self_heating",
    "film_drift",
    "creep",
    "meter_lag",
    "series_resistance",
    "parallel_leakage",
    "meter_range_error",
}
SHIFTS = {"self_heating": "theta_K_per_W", "film_drift": "drift_K_per_h"}  # what moves the film's temperature itself
FAINT = 0.03  # share of a move of the film's temperature
HALF_WIDTHS_K = np.geomspace(0.3, 10.0, 12)  # of the relays of a film outside the class
CENTRES = 20
UNCERTAIN = 1.0  # of the mean relay
SMOOTH = 0.3  # of the plane's sides, over which relays are uncertain together
FROZEN = {("meter_range_error", "threshold_ohm"), ("thermometer_quantization", "step_K")}


def threshold(parameters: int) -> float:
    """Half the 99.9 % quantile of chi-square."""
    return 0.5 * float(chi2.ppf(0.999, parameters))


class Oracle:
    """The view of a test that knows the rig, with the effects that it has, and the currents of a record."""

    def __init__(
        self,
        rig: Rig,
        schedule: Schedule,
        current: Array,
        *,
        cautious: bool = True,
        free_d: bool = True,
        more: Iterable[Effects] = (),
        channels: str = "both",
    ) -> None:
        """`cautious`: radii and form of D are not known either. `free_d`: the film's D(T) is free. `more`: effects that
        may be there too, a little. `channels`: "both", or "temperature" for a record without resistance."""
        self.rig = replace(rig, step_s=COARSE_S)
        self.schedule = replace(schedule, setpoint=None, current=current)
        step = rig.get("thermometer_quantization", "step_K")
        self.sigma_K = float(np.hypot(rig.noise_K, step / np.sqrt(12.0)))
        self.heat = thermal(self.rig, self.schedule)
        self.channels = channels
        self.base = self._weighted(self.rig, self.heat)
        columns = list(self._columns(free_d))
        if cautious:
            columns += list(self._of_shape(free_d))
        columns += [self.difference(effects) for effects in more]
        matrix = np.array(columns).T
        matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-30)
        u, s, _ = np.linalg.svd(matrix, full_matrices=False)
        self.span = u[:, s > 1e-8 * s[0]]
        self.uncertain: Array | None = None
        if channels == "both" and cautious and rig.film.kind != PLAY:
            relays = np.stack(list(self._of_any_density()), axis=1) @ _together()
            self.uncertain = np.stack([self.rest(column) for column in relays.T], axis=1)

    def _weighted(self, rig: Rig, heat: Thermal) -> Array:
        if self.channels == "temperature":
            return heat.seen / self.sigma_K
        y = log_ohm(rig, self.schedule, heat)
        return np.concatenate([heat.seen / self.sigma_K, y / rig.noise_dec])

    def _columns(self, free_d: bool) -> Iterator[Array]:
        for name, step in PLATE_STEPS:
            value = getattr(self.rig.plate, name)
            change = step * max(abs(value), 1.0) if "degC" in name else step * value
            plate = replace(self.rig.plate, **{name: value + change})
            yield self._moved(replace(self.rig, plate=plate), None) / step
        for film, step in self.rig.film.neighbours():
            same_d = film.form == self.rig.film.form and np.array_equal(film.d[:3], self.rig.film.d[:3])
            if free_d or same_d:
                yield self._moved(replace(self.rig, film=film), self.heat) / step
        for name, parameters in self.rig.effects.items():
            for key, value in parameters.items():
                if (name, key) not in FROZEN:
                    effects = {**self.rig.effects, name: {**parameters, key: 1.01 * value}}
                    yield self.difference(effects, whole=True) * 100.0

    def _of_shape(self, free_d: bool) -> Iterator[Array]:
        """Operators at radii that the film does not have; a D(T) of any smooth form."""
        if self.channels == "temperature":
            return
        for film, step in self.rig.film.operators_between():
            yield self._moved(replace(self.rig, film=film), self.heat) / step
        place = (self.heat.base[self.heat.taken] - 60.0) / 25.0
        for power in (1, 2, 3) if free_d else ():
            yield np.concatenate([np.zeros(place.size), place**power / self.rig.noise_dec])

    def _of_any_density(self) -> Iterator[Array]:
        """What each relay of the plane adds, at its standard deviation."""
        film, base, rows = self.rig.film, self.heat.base, self.heat.seen.size
        low, high = np.quantile(base, [0.02, 0.98])
        centres = np.linspace(low, high, CENTRES)
        mean = float(np.ptp(self.base[rows:])) * self.rig.noise_dec / (CENTRES * HALF_WIDTHS_K.size)
        for half_width in HALF_WIDTHS_K:
            for centre in centres:
                table = np.array([[half_width], [1.0], [centre], [0.7 * (centres[1] - centres[0])]])
                relay = Film(PREISACH, table, 0, np.zeros(4), film.before, "relay")
                y = log_ohm(Rig(self.rig.plate, relay, self.rig.noise_K, self.rig.noise_dec), self.schedule, self.heat)
                yield np.concatenate([np.zeros(rows), UNCERTAIN * mean * y / self.rig.noise_dec])

    def _moved(self, rig: Rig, heat: Thermal | None) -> Array:
        heat = thermal(rig, self.schedule) if heat is None else heat
        return self._weighted(rig, heat) - self.base

    def difference(self, effects: Effects, whole: bool = False) -> Array:
        """What adding the effects (or, with `whole`, having just these) changes, over the noise; to first order in the
        film's temperature."""
        now = self.rig.effects
        wanted = effects if whole else {**now, **effects}
        changed = {name for name in wanted if wanted[name] != now.get(name)}
        heat = self.heat if changed <= FILM_EFFECTS else thermal(self.rig.having(wanted), self.schedule)
        if self.channels == "temperature" or not np.array_equal(heat.taken, self.heat.taken):
            return self._moved(self.rig.having(wanted), heat)
        faint, direct = dict(now), dict(wanted)
        for name in changed & set(SHIFTS):
            key = SHIFTS[name]
            before = now.get(name, {}).get(key, 0.0)
            faint[name] = {key: before + FAINT * (wanted[name][key] - before)}
            direct[name] = {key: before}
        nearby = replace(self.heat, base=self.heat.base + FAINT * (heat.base - self.heat.base))
        rows = self.heat.seen.size
        base = self.base[rows:] * self.rig.noise_dec
        moved = (log_ohm(self.rig.having(faint), self.schedule, nearby) - base) / FAINT
        added = log_ohm(self.rig.having(direct), self.schedule, self.heat) - base
        shown = (heat.seen - self.heat.seen) / self.sigma_K
        return np.concatenate([shown, (moved + added) / self.rig.noise_dec])

    def rest(self, difference: Array) -> Array:
        """What no free parameter can imitate."""
        for _ in range(2):
            difference = difference - self.span @ (self.span.T @ difference)
        return difference

    def evidence(self, effects: Effects) -> float:
        """Expected log-likelihood ratio of the effects against a rig without them."""
        return self.evidence_of(self.difference(effects))

    def outside(self, **faults: object) -> Array:
        """What faults outside the catalogue change."""
        return self._moved(replace(self.rig, outside=faults), None)

    def with_film(self, film: Film) -> Array:
        """What another film changes."""
        return self._moved(replace(self.rig, film=film), self.heat)

    def evidence_of(self, difference: Array) -> float:
        """Expected log-likelihood ratio of a change."""
        rest = self.rest(difference)
        seen = float(rest @ rest)
        if self.uncertain is not None:
            along = self.uncertain.T @ rest
            covariance = self.uncertain.T @ self.uncertain + np.eye(along.size)
            seen -= float(along @ np.linalg.solve(covariance, along))
        return 0.5 * seen


def _together() -> Array:
    """How the relays' uncertainties come about from independent ones: a root of their correlation matrix."""
    width, centre = np.meshgrid(
        np.linspace(0.0, 1.0, HALF_WIDTHS_K.size), np.linspace(0.0, 1.0, CENTRES), indexing="ij"
    )
    place = np.stack((width.ravel(), centre.ravel()), axis=1)
    apart = np.linalg.norm(place[:, None, :] - place[None, :, :], axis=2)
    return np.asarray(np.linalg.cholesky(np.exp(-apart / SMOOTH)), dtype=np.float64)
