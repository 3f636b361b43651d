"""Compiles what the control law needs: `python -m compensator.precompile`.

The loops are kept on disk (`compensator.compiled`); `./peltier` starts this in the background after a set-up.
"""

from __future__ import annotations

import numpy as np

from compensator.control.estimator import FEWEST, model_error
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import PidGains
from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel

FILM = FilmModel(
    np.array([0.1, 0.4]),
    np.array([0.6, 0.4]),
    Envelope("tanh", 0.2, -12.6),
    Envelope("tanh", 0.2, -11.8),
    Memoryless("tanh", 0.4, 0.03, -1.6, -4.0),
)
PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)  # a usual one of 30 J/K


def precompile() -> None:
    """Compile by running, with a small film: a step of each law from a known and an unknown memory, one inversion, and
    one estimate of a model's error."""
    inverse = Inverse(FILM)
    memory = inverse.first(-4.2).memory
    inverse.solve(-4.0, memory)
    inverse.trajectory(np.array([-4.0, -4.1]), memory)
    for name in ("full", "temperature"):
        settings = LawSettings(name, 0.1, 4.0, 10.0, 95.0, PidGains(1.0, 0.1))
        law = Law(settings, PLATE, FILM)
        wanted = np.full(settings.preview, 60.0 if name == "temperature" else -4.2)
        inputs = Inputs(58.0, -4.3, float(wanted[0]), wanted)
        _, state = law.step(law.start(58.0, None), inputs)
        law.late(state, 0.0, 0.01)
        if name == "full":
            law.step(law.start_anywhere(58.0, -4.3), inputs)
    PLATE.rate_range_K_per_s(50.0, 1.0)
    PLATE.current_for_rate_A(50.0, 0.0, 1.0)
    PLATE.linearized(50.0, 1.0)
    model_error(np.sin(np.arange(2.0 * FEWEST)), np.ones(2 * FEWEST))


if __name__ == "__main__":
    precompile()
