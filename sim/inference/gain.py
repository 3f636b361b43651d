"""By how much one simulation's errors are smaller than another's, with an interval of the reduction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

BLOCKS: Final = 60  # of rows, drawn together: residuals hang together over less
RESAMPLES: Final = 1000  # an interval's ends are then within 3 % of its width


@dataclass(frozen=True)
class Gain:
    """Root mean square error before and after, and the 95 % interval of its reduction, 1 - after / before."""

    rmse_before: float
    rmse_after: float
    reduction_ci95: tuple[float, float]


def rms(values: Array) -> float:
    """Return the root mean square of some values, nan of none."""
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def gain(before: Array, after: Array, rows: NDArray[np.bool_]) -> Gain:
    """Return what is gained in some rows. before, after: residuals, (rows,), nan where there is no reading; blocks of
    rows are drawn with replacement (H. R. Kuensch, Ann. Statist. 17 (1989) 1217)."""
    seen = np.flatnonzero(rows & np.isfinite(before) & np.isfinite(after))
    if not seen.size:
        return Gain(math.nan, math.nan, (math.nan, math.nan))
    _, place = np.unique(seen * BLOCKS // before.size, return_inverse=True)
    count = int(place.max()) + 1
    b, a = (np.bincount(place, values[seen] ** 2, minlength=count) for values in (before, after))
    draw = np.random.default_rng(0).integers(0, count, (RESAMPLES, count))
    reduction = 1.0 - np.sqrt(a[draw].sum(axis=1) / np.maximum(b[draw].sum(axis=1), 1e-300))  # > 0: without noise
    low, high = (float(v) for v in np.percentile(reduction, [2.5, 97.5]))  # 95 % between them
    return Gain(rms(before[seen]), rms(after[seen]), (low, high))
