"""Run a model over a record that it was not fitted to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rig.analysis.beyond_seen import beyond_seen
from rig.analysis.predicted import Prediction, predicted
from rig.analysis.prediction_error import (
    ChannelError,
    errors_of,
    fitted_values,
    gap_note,
    left_out,
    predicted_columns,
    require_something_to_predict,
    room_note,
)
from rig.config.effect_tables import add_effect_files
from rig.core.python_words import in_python
from rig.experiment.feasible import order_warning
from rig.notebook.models import as_model
from rig.notebook.records import as_record
from rig.notebook.shown import Shown
from rig.records.record import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from compensator.hysteresis.functions import Array


@dataclass(frozen=True, eq=False, repr=False)
class PredictedRecord(Shown):
    """A record as a model predicts it, each array of shape (rows,).

    columns: predicted_ohm (or predicted_ with the output's column) and predicted_degC; residual_dec and residual_K,
    measured - model. errors: of each channel that was
    measured too, over the rows to which nothing was fitted; rmse_dec, rmse_K: the same, None where there is none.
    fitted: what belongs to the record, where it was fitted: ambient_degC, first_degC, memory. notes: what to know.
    """

    columns: dict[str, Array]
    errors: tuple[ChannelError, ...]
    fitted: dict[str, Any]
    notes: tuple[str, ...]
    record: Record = field(repr=False)
    found: Prediction = field(repr=False)

    @property
    def rmse_dec(self) -> float | None:
        """Of log10 R, decades."""
        return self._rmse("dec")

    @property
    def rmse_K(self) -> float | None:
        """Of the plate's temperature, K."""
        return self._rmse("K")

    @property
    def lines(self) -> tuple[str, ...]:  # type: ignore[override]
        """What `print` shows."""
        return (*(error.in_words() for error in self.errors), *self.notes) or ("nothing to compare",)

    def plot(self) -> Figure:
        """Measured and predicted over time, a panel for each channel."""
        from rig.report.model_figures import drawn_over_time

        return drawn_over_time(self.record["time_s"], self.errors)

    def _rmse(self, unit: str) -> float | None:
        return next((error.rmse for error in self.errors if error.unit == unit), None)


@in_python()
def predict(
    model: Any,
    record: Any,
    *,
    initial: Literal["cooled", "heated", "fitted"] | None = None,
    drive: Literal["current", "temperature"] | None = None,
    first_s: float | None = None,
    effect_files: Iterable[Path | str] = (),
) -> PredictedRecord:
    """The film's output and, from the record's current, the plate's temperature: simulated, never one step ahead.

    model: a Model, an identification or a diagnosis, or a model file's path. record: a `Record`, or what `read_record`
    reads. initial: the film's memory at the first row, None: the model's own; "fitted": with the room's and the first
    temperature, to the first rows (first_s seconds; None: 30 s or 20 rows, the longer). drive: what the film follows,
    the simulated plate or the thermometer; None: as the model says. effect_files: effects of one's own. Raises Faults.
    """
    add_effect_files(Path(path) for path in effect_files)
    known, where = as_model(model)
    rows = as_record(record)
    require_something_to_predict(known, rows, where, drive)
    found = predicted(known, rows, where, initial=initial, drive=drive, first_s=first_s)
    order = order_warning(known.film, where) if known.film is not None else None
    beyond = beyond_seen(known, rows["temperature_degC"], where)
    warnings = (order, beyond, left_out(known, rows), gap_note(found, rows), room_note(found, known, rows))
    errors = tuple(errors_of(found, known, rows))
    return PredictedRecord(
        predicted_columns(found, known, errors),
        errors,
        fitted_values(found, known),
        (*rows.left_out_lines(), *(note for note in warnings if note is not None)),
        rows,
        found,
    )
