"""How far a film model's output jumps where the temperature reverses: 0 where it keeps the order condition."""

from __future__ import annotations

from typing import Final

import numpy as np

from compensator.hysteresis.film import FilmModel

# Of the sum of the weights: far below any ohmmeter's noise. An identification looks for the least allowed radius where
# the transition is; far out in the tails of two tanh of unlike slope one wall may still be above the other by less.
LEAST_JUMP: Final = 1e-6


def reversal_jumps(model: FilmModel, low_degC: float = -50.0, high_degC: float = 200.0) -> tuple[int, float]:
    """(operators of positive weight that violate gamma_R - r <= gamma_L + r between two temperatures, the largest jump
    of the output at a reversal, in the output's unit); (0, 0.0) where it is below anything that can be measured."""
    by = model.weights * np.maximum(-model.order_margin(low_degC, high_degC), 0.0)
    jump = float(np.sum(by))
    if not jump > LEAST_JUMP * float(np.sum(model.weights)):
        return 0, 0.0
    return int(np.sum(by > 0.0)), jump
