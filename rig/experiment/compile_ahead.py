"""Compiles what an experiment computes before its first pulse: in its middle the plate would wait for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from compensator import listeners
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import LawName
from compensator.control.pid import PidGains
from compensator.inverse.check import check_model
from compensator.precompile import FILM, PLATE, precompile
from rig.control.policies import warmed_up
from rig.experiment.extended_model import chain_observer
from sim.effects.actuator_delay import EFFECT as ACTUATOR_DELAY
from sim.effects.effect import switched
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG
from sim.inference.film.fit import identify_film
from sim.inference.plate.fit import identify_plate

LONG_S = 2.0  # from which its end is reported, too
PERIOD_S = 0.1


def compile_ahead(say: Callable[[str], None], calibrates: bool) -> None:
    """Compile the control law, and where a calibration is to come its fits and the laws behind a thermometer that lags;
    what is on disk already is loaded. say: called where it takes long."""
    began_s = time.monotonic()
    with _reported(say):
        precompile()
        if calibrates:
            _precompile_film_fit()
            _precompile_plate_fit()
            behind = [switched(ACTUATOR_DELAY, {"delay_s": PERIOD_S}), switched(SENSOR_LAG, {"tau_s": 1.0})]
            names: tuple[LawName, ...] = ("temperature", "full")
            for name in names:
                film = FILM if name == "full" else None
                settings = LawSettings(name, PERIOD_S, 4.0, 10.0, 95.0, PidGains(1.0, 0.1))
                law = warmed_up(Law(settings, PLATE, film, chain_observer(behind, PLATE, film, PERIOD_S)))
                law.late(law.start(25.0, None), 0.0, 0.5 * PERIOD_S)
    took_s = time.monotonic() - began_s
    if took_s > LONG_S:
        say(f"compiled in {took_s:.0f} s")


def _precompile_film_fit() -> None:
    """Fit a small film to two sweeps, and check it."""
    time_s = np.arange(150.0) * 0.4
    degC = 60.0 + 25.0 * np.sin(time_s * np.pi / 15.0)
    output, _ = FILM.simulate(degC, FILM.initial_memory(float(degC[0])))
    fit = identify_film(
        time_s, degC, output, kind="extended_generalized_pi", form="tanh", operators=2, initial="heated"
    )
    check_model(fit.model, 40.0, 80.0)


def _precompile_plate_fit() -> None:
    """Fit a plate to a minute of a current, read more and less often than it is simulated."""
    time_s = np.append(np.arange(0.0, 40.0, 0.4), np.arange(40.0, 60.0, 2.0))
    current_A = np.where(time_s < 20.0, 1.5, np.where(time_s < 40.0, -1.0, 0.0))
    identify_plate(time_s, PLATE.simulate(25.0, time_s, current_A), current_A, lag=True)


@contextmanager
def _reported(say: Callable[[str], None]) -> Iterator[None]:
    """Report through `say` that loops are compiled."""
    listeners.append(say)
    try:
        yield
    finally:
        listeners.remove(say)
