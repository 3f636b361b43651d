"""Values of an effect of the last links to begin a fit from."""

from __future__ import annotations

from itertools import product

import numpy as np

from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.effects.effect import Effect, Parameter, Switched, Warming, switched

FEWEST_ROWS = 30  # on either side of a threshold
SIZES = 4  # of an effect that are looked at


def thresholds_inside(threshold: Parameter, channel: ResistanceChannel) -> tuple[float, ...]:
    """The choices of a threshold with enough rows on either side; the one that is known, where it is."""
    if len(threshold.choices) == 1:
        return threshold.choices
    ohm = channel.record.quantity.ohm(channel.output[channel.rows])
    return tuple(c for c in threshold.choices if min(np.sum(ohm > c), np.sum(ohm <= c)) >= FEWEST_ROWS)


def starts_of(effect: Effect, channel: ResistanceChannel, sizes: int = SIZES) -> list[Switched]:
    """Values of an effect to begin from: over the sizes met, of both signs, each choice that the record can show."""
    axes: list[list[float]] = []
    for k, p in enumerate(effect.parameters):
        if p.choices:
            axes.append([*thresholds_inside(p, channel)] or [p.choices[0]])
        elif p.signed:
            values = np.geomspace(p.smallest, p.largest, sizes)[::2]
            axes.append([float(v) for v in (*-values[::-1], *values)])
        else:  # three values of what an effect has besides its size
            axes.append([float(v) for v in np.geomspace(p.smallest, p.largest, sizes if k == 0 else 3)])
    heated = isinstance(effect.form, Warming) and effect.form.heated and not effect.parameters[0].choices
    if heated and channel.record.test_current_A is not None:
        ohm = channel.record.quantity.ohm(channel.output[channel.rows])
        power = channel.record.test_current_A[channel.rows] ** 2 * ohm
        largest = max(float(np.max(power)), 1e-30)  # > 0
        # warmer by so many K at the largest power, within 1 to 1e5 K/W: any film on any substrate
        axes[0] = [min(max(k / largest, 1.0), 1e5) for k in (0.02, 0.2, 1.0, 3.0)]
    return [switched(effect, list(values)) for values in product(*axes)]
