"""Compiles what the control law needs, so that the first run need not wait for it: `python -m compensator.precompile`.

The compiled loops are cached beside their sources; `./peltier` starts this in the background after a set-up.
"""

from __future__ import annotations

import numpy as np

from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.model_error import FEWEST, lacking
from compensator.control.pid import PidGains
from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel


def precompile() -> None:
    """One step of each law, from a known and from an unknown memory, one inversion, and what a run taught, with a small
    film."""
    film = FilmModel(
        np.array([0.1, 0.4]),
        np.array([0.6, 0.4]),
        Envelope("tanh", 0.2, -12.6),
        Envelope("tanh", 0.2, -11.8),
        Memoryless("tanh", 0.4, 0.03, -1.6, -4.0),
    )
    plate = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
    inverse = Inverse(film)
    inverse.solve(-4.0, inverse.first(-4.2).memory)
    for name in ("full", "temperature"):
        settings = LawSettings(name, 0.1, 4.0, 10.0, 95.0, PidGains(1.0, 0.1))
        law = Law(settings, plate, film)
        wanted = np.full(settings.preview, 60.0 if name == "temperature" else -4.2)
        inputs = Inputs(58.0, -4.3, float(wanted[0]), wanted)
        law.step(law.start(58.0, None), inputs)
        if name == "full":
            law.step(law.start_anywhere(58.0, -4.3), inputs)
    lacking(np.sin(np.arange(2.0 * FEWEST)), np.ones(2 * FEWEST))


if __name__ == "__main__":
    precompile()
