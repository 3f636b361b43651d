"""An effect that bends the reading, bent softer or sharper: shown^p = R^p + series_ohm^p; p = 1: the effect itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Reading


def of_sharpness(effect: Effect, power: float) -> Effect:
    """An effect at the ohmmeter's terminals with another sharpness p of its bend."""
    form = effect.form
    assert isinstance(form, Reading)

    def read(par: Array, values: Array) -> Array:
        return np.asarray(form.read(par**power, values**power) ** (1.0 / power))

    return replace(effect, name=f"{effect.name} of sharpness {power:g}", form=Reading(read))
