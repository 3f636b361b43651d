"""Whether a current changed between the rows of a record, and nobody logged it.

In a record as it should be a current acts from its row on. Where every second or fourth row was kept, or a log was
slower than its controller, a change that a row shows began some time before that row, and the temperature bends before
the change is seen. So, with b(k) the change of the temperature's slope at row k,

    b(k) = a_0 dI(k -> k+1) + a_1 dI(k-1 -> k) + a_2 dI(k-2 -> k-1) + ...

and a_0 is 0 for whatever plate, sink and lag there are: no cause comes after what it does (C. A. Sims, Amer. Econ. Rev.
62 (1972) 540). A controller that answers its own noise makes a_0 negative, never positive: it cools what reads warm.
This knows no model. (Full simulated records: -6 to -1 standard deviations; each second, each fourth of their rows: 8 to
13. A delay of whole rows hides it.)
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

SURE: Final = 6.0  # standard deviations: one record in a thousand million by chance
EARLIER: Final = 5  # changes before: what a lag of some rows still shows of them
TOGETHER: Final = 4  # rows over which the noise of a bend hangs together: two, and a little that the plate adds
FEWEST: Final = 100  # bends
ROUNDING: Final = 1e-9  # of a leverage of 1
LEAST: Final = 0.1  # of what acts from the row on: rows a fifth of the plate's own time long bend as much by themselves
MOST: Final = 0.5  # of a row's change: the mean, where it may have begun anywhere between two rows


def acted_before(time_s: Array, temperature_degC: Array, current_A: Array, broken: NDArray[np.int64]) -> float:
    """What share of the change from one row to the next had acted on average in the time between them; 0: none that is
    sure. temperature_degC, current_A: nan without a reading; broken: rows before which rows are missing."""
    step, rows = np.diff(time_s), time_s.size
    if rows < FEWEST + EARLIER:
        return 0.0
    slope, change = np.diff(temperature_degC) / step, np.diff(current_A)
    slope[broken - 1] = np.nan
    k = np.arange(EARLIER + 1, rows - 1)
    columns = np.stack([change[k - j] for j in range(EARLIER + 2)] + [np.ones(k.size)], axis=1)
    bend = slope[k] - slope[k - 1]
    known = np.isfinite(bend) & np.all(np.isfinite(columns), axis=1)
    columns, bend = columns[known], bend[known]
    if bend.size < FEWEST or np.linalg.matrix_rank(columns) < columns.shape[1]:
        return 0.0
    inverse = np.linalg.inv(columns.T @ columns)
    a = inverse @ (columns.T @ bend)
    # where one bend decides a coefficient alone, the fit goes through it and leaves nothing of its noise: what is left
    # is divided by 1 less the leverage (J. MacKinnon, H. White, J. Econometrics 29 (1985) 305)
    leverage = np.sum((columns @ inverse) * columns, axis=1)
    left = (bend - columns @ a) / np.maximum(1.0 - leverage, ROUNDING)
    score = columns * left[:, None]
    spread = score.T @ score  # W. K. Newey, K. D. West, Econometrica 55 (1987) 703
    for lag in range(1, TOGETHER + 1):
        cross = score[lag:].T @ score[:-lag]
        spread += (1.0 - lag / (TOGETHER + 1)) * (cross + cross.T)
    deviation = np.sqrt(np.diag(inverse @ spread @ inverse))
    j = 1 + int(np.argmax(np.abs(a[1:-1])))  # of a delayed command most comes in a later row
    before, after = float(a[0] * np.sign(a[j])), abs(float(a[j]))
    if before <= max(SURE * deviation[0], LEAST * after) or after <= SURE * deviation[j]:
        return 0.0
    return min(before / (before + after), MOST)
