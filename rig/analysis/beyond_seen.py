"""Whether a film is asked about temperatures at which nobody has measured it."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from rig.config.model_file import Model

FURTHER_K = 1.0  # than the records went: a plate that is sent to the same end twice passes it by as much


def beyond_seen(model: Model, temperature_degC: Array, where: object) -> str | None:
    """A line where temperatures, (rows,), nan allowed, lie beyond those of the records that told the film. where: the
    model's file."""
    if model.film is None or model.film_seen_degC is None:
        return None
    low, high = model.film_seen_degC
    beyond = int(np.sum((temperature_degC < low - FURTHER_K) | (temperature_degC > high + FURTHER_K)))
    if not beyond:
        return None
    furthest = temperature_degC[np.nanargmax(np.maximum(low - temperature_degC, temperature_degC - high))]
    rows = "1 temperature lies" if beyond == 1 else f"{beyond} temperatures lie"
    return (
        f"{where}: film_seen_degC: {rows} beyond {low:.1f} to {high:.1f} degC, where the film was measured, up to "
        f"{furthest:.1f} degC: what the model says there, nobody has seen"
    )
