"""Whether what was fitted carries over to rows that no fit has seen.

Such rows are missed by the noise, by the plate's path between the rows, and by what the fitted rows leave open of the
film. How much the last is hangs on the film's prior where next to nothing was read: one width for the whole Preisach
plane, while a film's density may stand in one place of it. A film that goes where it went but once, or never, is missed
by several times what is left open. So where a film is missed, rows that the fitted ones tell worse than a reading of
their own would are not counted against the fit, as long as at least half are told better.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from sim.diagnosis.judge.verdict import UNSEEN
from sim.diagnosis.validate.gain import rmse
from sim.diagnosis.validate.held_out_rows import HeldOutRows

LEAST_TOLD: Final = 0.5  # of the rows: what fewer say is not said of the record
FILM: Final = "resistance_dec"


@dataclass(frozen=True)
class CarriedOver:
    """By channel: expected, the RMSE with the true effects, K and decades; times, the RMSE over what is expected, of a
    film over the rows that are counted; not_counted: of the film, how many of how many rows are not, where these alone
    are missed."""

    expected: dict[str, float]
    times: dict[str, float]
    not_counted: tuple[int, int] = (0, 0)


def carried_over(held_out: HeldOutRows, names: frozenset[str]) -> CarriedOver:
    """Of the fit with these effects; what belongs to another record is fitted to all of it, since what its first rows
    leave open of that is no fault of the model."""
    left = held_out.left_everywhere(names)
    counted = {name: held_out.rows & np.isfinite(residual) for name, residual in left.items()}
    expected = held_out.noise(names, with_path=True)
    times = {name: rmse(residual[counted[name]]) / expected[name] for name, residual in left.items()}
    if times.get(FILM, 0.0) <= UNSEEN:
        return CarriedOver(expected, times)
    missed, rows = left[FILM], counted[FILM]
    open_dec, noise_dec = held_out.film_left_open_dec(names), held_out.film_noise_dec()
    foreseen = np.hypot(open_dec, noise_dec)
    expected[FILM] = rmse(foreseen[rows])
    times[FILM] = rmse(missed[rows]) / expected[FILM]
    told = rows & (open_dec <= noise_dec)
    every, few = int(np.sum(rows)), int(np.sum(told))
    if times[FILM] <= UNSEEN or few < LEAST_TOLD * every:
        return CarriedOver(expected, times)
    of_told = rmse(missed[told]) / rmse(foreseen[told])
    if of_told > UNSEEN:
        return CarriedOver(expected, times)
    return CarriedOver(expected, {**times, FILM: of_told}, (every - few, every))
