"""What further parameters must gain before they are believed: one price, everywhere.

    price(k) = 1/2 chi2_k^-1(1 - FALSE_ALARM / candidates) + k/2 ln(rows)

The first part keeps the rate at which chance names one of several candidates (S. S. Wilks, Ann. Math. Stat. 9 (1938)
60, with a Bonferroni correction); the second is what a parameter's own spread costs (G. Schwarz, Ann. Stat. 6 (1978)
461).
"""

from __future__ import annotations

import math
from typing import Final

from scipy.special import chdtri

FALSE_ALARM: Final = 0.01  # a record without the effect names one of the candidates this often, at most
FALSE_ALARMS: Final = (1e-12, 0.05)  # shares that may be chosen: no distribution is known below, none is wanted above


def price(parameters: int, rows: int, candidates: int = 1, false_alarm: float = FALSE_ALARM) -> float:
    """Return the log-likelihood that so many more parameters must gain on a record of so many readings."""
    chance = 0.5 * float(chdtri(parameters, false_alarm / candidates))
    return chance + 0.5 * parameters * math.log(rows)
