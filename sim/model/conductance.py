"""An effect on a resistance as one on its conductance: of r it makes read(r), of g it makes 1 / read(1 / g)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Reading


def of_conductance(effect: Effect) -> Effect:
    """Return the same effect on a conductance, where it is one on a resistance."""
    form = effect.form
    if not (effect.link == "ohmmeter" and isinstance(form, Reading)):
        return effect

    def read(par: Array, values: Array) -> Array:
        return np.asarray(1.0 / form.read(par, 1.0 / values), dtype=np.float64)

    return replace(effect, form=replace(form, read=read))
