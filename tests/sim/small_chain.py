"""A small world for tests of the signal chain: a film of the class, a current that goes up and down, middle sizes."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.thermal.plate import PlateModel
from rig.config.effect_tables import typical_value
from sim.effects.catalogue import catalogue
from sim.effects.effect import Switched, switched
from sim.world.plant import World

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
FILM = FilmModel(
    np.array([0.05, 0.2, 0.5, 0.8]),
    np.array([0.4, 0.3, 0.2, 0.1]),
    Envelope("tanh", 0.2, -12.6),
    Envelope("tanh", 0.2, -11.8),
    Memoryless("tanh", amplitude=0.4, a=0.03, b=-1.6, offset=-4.0),
)
TIME = np.arange(0.0, 300.0, 0.5)
CURRENT = 0.9 + 0.8 * np.sin(TIME / 40.0) + 0.5 * np.sign(np.sin(TIME / 7.0))
TEST_CURRENT_A = 3e-4


def on(name: str, **values: float) -> Switched:
    """An effect; what is not given takes the middle of the sizes met."""
    effect = catalogue()[name]
    return switched(effect, {p.name: values.get(p.name, typical_value(p)) for p in effect.parameters})


def world(*effects: Switched) -> World:
    """Without noise."""
    return World(PLATE, FILM, first_degC=50.0, thermometer_noise_K=0.0, ohmmeter_noise_dec=0.0, effects=effects)
