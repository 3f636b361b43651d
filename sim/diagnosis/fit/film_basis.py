"""What a record's film is built of: D's splines, places of the play operators' radii, and the plane of relays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record
from sim.diagnosis.data.sparse_loop import one_loop
from sim.diagnosis.fit.preisach_density import MINOR_LOOPS, ONE_LOOP, RelayPlane
from sim.model.film_columns import SmoothCurve
from sim.model.film_mixing import FilmMixing
from sim.model.plate_path import PlatePath

OPERATORS = 96  # radii a hundredth of the loop apart: any weights are smooth on that scale
PER_OPERATOR = 2  # readings that an operator needs at least; its prior does the rest
FEW_READINGS = 800  # of a single loop, for which a plane with twice the columns costs next to nothing
ENVELOPES = 4  # unknowns of the two envelopes: log a and c of the rising one, then of the falling one
SHAPE = ENVELOPES + 3  # and of how the phases of another film mix: change of their step, exponent, percolation
MARGIN_K = 0.5  # beyond the plate's temperatures
REACH = 4.5  # of the relays' centres to either side, times the range in which the middle half of the change is
LEAST_REACH = 0.03  # the same, of the range of temperatures
FARTHEST = 0.6  # the same, of the range of temperatures


@dataclass(frozen=True, eq=False)
class FilmBasis:
    """curve: D's splines, None without D; fractions: the radii's places from the smallest one to 1, (operators,);
    plane: of relays; mixing: where the phases of such a film mix."""

    curve: SmoothCurve | None
    fractions: Array
    plane: RelayPlane
    mixing: FilmMixing

    @classmethod
    def over(
        cls, record: Record, path: PlatePath, quartiles_degC: tuple[float, float, float], curve: bool
    ) -> FilmBasis:
        """Placed for a record: D's splines over the range, relays where the output changes. quartiles_degC: below which
        a quarter, a half and three quarters of its change are."""
        low, high = float(np.min(path.plate_degC)), float(np.max(path.plate_degC))
        assert record.output is not None
        readings = int(np.sum(record.output_used))
        operators = min(OPERATORS, max(readings // PER_OPERATOR, 12))  # four to a third of the loop, as a flank is
        first, middle_degC, third = quartiles_degC
        reach = min(max(REACH * (third - first), LEAST_REACH * (high - low)), FARTHEST * (high - low))
        output = record.output[record.output_used]
        extent = ONE_LOOP if readings < FEW_READINGS and one_loop(record) else MINOR_LOOPS
        farthest_K = max(high - middle_degC, middle_degC - low)
        return cls(
            SmoothCurve.over(low - MARGIN_K, high + MARGIN_K) if curve else None,
            np.arange(operators) / operators,
            RelayPlane.over(middle_degC, reach, (low, high), readings, extent),
            FilmMixing(middle_degC, farthest_K, float(np.min(output)), float(np.max(output))),
        )

    @property
    def free(self) -> int:
        """Columns of the constant and of D."""
        return 1 + (self.curve.count if self.curve is not None else 0)

    @property
    def columns(self) -> int:
        """Columns of the film itself: constant, D, operators; those of filters follow, then relays."""
        return self.free + self.fractions.size
