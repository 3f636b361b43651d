"""A number with its 95 % interval, or why a record does not determine it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array

INSIDE = 0.95  # the intervals' coverage, as everywhere here


@dataclass(frozen=True)
class Quantity:
    """value and the ends of its 95 % interval; both None where the record does not determine it, for the `reason`."""

    value: float | None
    ci95: tuple[float, float] | None
    reason: str = ""

    def table(self) -> dict[str, object]:
        """As JSON has it."""
        found: dict[str, object] = {"value": self.value, "ci95": list(self.ci95) if self.ci95 else None}
        return found | ({"reason": self.reason} if self.reason else {})


def untold(reason: str) -> Quantity:
    """No number, and why."""
    return Quantity(None, None, reason)


def told(value: float, draws: Array, more: float = 0.0) -> Quantity:
    """The number with an interval about it that holds 95 % of the draws, shape (draws,), which scatter about it as it
    does about the truth; more: half of what else is not known, added as an independent error."""
    half = float(np.hypot(np.quantile(np.abs(draws - value), INSIDE), more))
    return Quantity(value, (value - half, value + half))
