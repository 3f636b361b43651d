"""A law that knows the model's [[effects]]: what goes into the law and comes out of it is corrected, link by link.

The law lives in the film: its temperature is that of the film when the next command acts, its output the film's own.

    driver        the plate is predicted through the currents that are on their way
    plate         the ambient that the plate's inverse reckons with is the one that gives the loss with the effects
    thermometer   a reading is compared with what a lagging thermometer would show
    film          a lag: the plate goes to T + tau dT/dt of the film's reference; warmings are taken off
    ohmmeter      targets and readings become the film's own (leads, leakage, range); with a lag or a skew the target
                  comes earlier, and a reading is compared with a model that is as late

The target is what the ohmmeter shall show, so that its lag is made up for too. What the effects leave goes the way of
every error of the model: into the law's feedback. Laws without a model ("pid") and without a current
("instrument_pid") gain nothing from it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compensator.control.law import Command, Law, LawName, LawSettings, LawState
from compensator.control.pid import PidState, integral_of, output_of
from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from rig.experiment.extension import Extension
from rig.files.film_output import RISING_RESISTANCE
from rig.files.target import Target
from rig.safety.first_plate import KnownPlate
from sim.effects.effect import Switched
from sim.model.links import links_of
from sim.model.own_output import own_output_table

COMPENSATED: tuple[LawName, ...] = ("full", "feedforward", "temperature")

SLOWED_S = 2.0  # a film that lags by this much is planned for at half of the plate's rates
SMOOTHED_SHARE = 0.15  # of the film's lag: over which the rate of its reference is smoothed


class ExtendedLaw(Law):
    """See the module. Its extension goes on from step to step, so that steps have to be those of one run, in order."""

    def __init__(self, settings: LawSettings, plate: PlateModel, film: FilmModel | None, extension: Extension) -> None:
        slower = 1.0 + extension.film_lag_s / SLOWED_S
        spacing, share = settings.preview_spacing_s * slower, settings.rate_share / slower
        super().__init__(replace(settings, preview_spacing_s=spacing, rate_share=share), plate, film)
        self.extension = extension
        self._plate_pid = PidState()
        self._plate_degC = self._rate = math.nan

    def preview_times_s(self) -> Array:
        """How far ahead of a step each target lies that it is given."""
        ahead: Array = super().preview_times_s() + self.extension.lead_s
        return ahead

    def step(
        self,
        state: LawState,
        temperature_degC: float,
        output: float,
        target_now: float,
        targets: Array,
        output_age_s: float = 0.0,
        acts_after_s: float = 0.0,
    ) -> tuple[Command, LawState]:
        """As `Law.step`; readings and targets are the instruments' own."""
        x, name = self.extension, self.settings.name
        x.observe(state.temperature_degC, temperature_degC if name != "feedforward" else math.nan)
        here, plate_degC = x.ahead_degC()
        self.plate = replace(x.plate_now, ambient_degC=x.plate_now.ambient_degC + here - plate_degC)
        if self.film is not None:
            output = self.film.step(here, state.memory)[0] + float(x.own(output)) - x.shown_own()
        if name != "temperature":
            targets = x.own(targets)
        a, g = self.plate.ambient_degC, self.plate.conductance_over_capacity_per_s
        before = a + (here - a) * math.exp(g * x.period_s)  # from there the law comes to `here` without a current
        state = replace(state, temperature_degC=before, current_A=0.0)
        command, following = super().step(state, math.nan, output, target_now, targets, output_age_s, acts_after_s)
        following = replace(following, temperature_degC=here)
        if x.film_lag_s > 0.0:
            current = self._through_the_lag(command.reference_degC, following.reference_degC, here, plate_degC)
            command = replace(command, current_A=current)
            following = replace(following, current_A=current)
        x.sent(command.current_A)
        return command, following

    def _through_the_lag(self, reference: float, following: float, here: float, plate_degC: float) -> float:
        """The current that takes the plate where the film's reference, from now to the next period, needs it."""
        x, pid, gains = self.extension, self._plate_pid, self._gains
        warming = x.warming_K
        rate = (following - reference) / x.period_s
        share = x.period_s / (x.period_s + SMOOTHED_SHARE * x.film_lag_s)
        self._rate = rate if math.isnan(self._rate) else self._rate + share * (rate - self._rate)
        wanted = reference + x.film_lag_s * self._rate - warming
        before = self._plate_degC if math.isfinite(self._plate_degC) else wanted
        rate, derivative, error = (wanted - before) / x.period_s, pid.derivative, pid.weighted_error
        if self.settings.name != "feedforward":
            correction, derivative, error = output_of(
                gains, pid.integral, derivative, error, wanted, plate_degC, x.period_s
            )
            rate += correction
        plate, limit = x.plate_now, self.settings.current_limit_A
        current = plate.current_for_rate_A(plate_degC, rate, limit)
        shortfall = plate.rate_K_per_s(plate_degC, current) - rate
        if self.settings.name == "feedforward":
            self._plate_degC = before + x.period_s * plate.rate_K_per_s(plate_degC, current)  # what it could follow
            return current
        integral = integral_of(gains, pid.integral, wanted, plate_degC, shortfall, x.period_s)
        self._plate_pid, self._plate_degC = PidState(integral, derivative, error), wanted
        return current


def known_plate(plate: PlateModel, effects: Sequence[Switched]) -> KnownPlate:
    """Plate and thermometer of a model, as a run is watched by them."""
    own = {e.effect.name: e.values() for e in effects}
    lag_s = own.get("sensor_lag", {}).get("tau_s", 0.0)
    return KnownPlate(plate, lag_s, own.get("actuator_delay", {}).get("delay_s", 0.0))


def plate_extension(effects: Sequence[Switched], plate: PlateModel, period_s: float) -> Extension | None:
    """For a temperature that is wanted of the plate itself: effects up to the thermometer, None where there is none."""
    chosen = [e for e in effects if e.effect.link in ("driver", "plate", "thermometer")]
    return Extension(chosen, plate, None, period_s, lambda: 0.0) if chosen else None


def own_target(target: Target, film: FilmModel | None, effects: Sequence[Switched]) -> Target:
    """The wanted course of the film's own resistance, for a target that the ohmmeter shall show."""
    if target.quantity == "resistance" and film is not None and film.output == RISING_RESISTANCE:
        return replace(target, values=-target.values)
    table = own_output_table(links_of(effects), film) if target.quantity == "resistance" else None
    if table is None:
        return target
    return replace(target, values=np.asarray(np.interp(target.values, *table), dtype=np.float64))
