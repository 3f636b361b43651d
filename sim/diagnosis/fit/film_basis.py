"""What a record's film is built of: D's splines, places of the play operators' radii, and the plane of relays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record
from sim.diagnosis.fit.preisach_density import RelayPlane
from sim.model.film_columns import SmoothCurve
from sim.model.plate_path import PlatePath

OPERATORS = 96  # radii a hundredth of the loop apart: any weights are smooth on that scale
PER_OPERATOR = 2  # readings that an operator needs at least; its prior does the rest
ENVELOPES = 4  # unknowns of the two envelopes: log a and c of the rising one, then of the falling one
MARGIN_K = 0.5  # beyond the plate's temperatures
REACH = 2.2  # of the relays' centres to either side, times half the transition's width
FARTHEST = 0.6  # the same, of the range of temperatures


@dataclass(frozen=True, eq=False)
class FilmBasis:
    """curve: D's splines, None without D; fractions: the radii's places from the smallest one to 1, (operators,);
    plane: of relays."""

    curve: SmoothCurve | None
    fractions: Array
    plane: RelayPlane

    @classmethod
    def over(cls, record: Record, path: PlatePath, middle_degC: float, half_width_K: float, curve: bool) -> FilmBasis:
        """Placed for a record: D's splines over the range, relays where the output changes."""
        low, high = float(np.min(path.plate_degC)), float(np.max(path.plate_degC))
        readings = int(np.sum(record.output_used))
        operators = min(OPERATORS, max(readings // PER_OPERATOR, 12))  # four to a third of the loop, as a flank is
        reach = min(REACH * half_width_K, FARTHEST * (high - low))
        return cls(
            SmoothCurve.over(low - MARGIN_K, high + MARGIN_K) if curve else None,
            np.arange(operators) / operators,
            RelayPlane.over(middle_degC, reach, high - low, readings),
        )

    @property
    def free(self) -> int:
        """Columns of the constant and of D."""
        return 1 + (self.curve.count if self.curve is not None else 0)

    @property
    def columns(self) -> int:
        """Columns of the film itself: constant, D, operators; those of filters follow, then relays."""
        return self.free + self.fractions.size
