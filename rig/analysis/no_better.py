"""Whether an extended model tells the run that it was found in better than the model that the run had."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rig.analysis.predicted import predicted
from rig.analysis.prediction_error import ChannelError, errors_of
from rig.files.model_file import read_model
from rig.files.record_file import Record


def no_better(extended: Path, own: Path, record: Record, channel: str) -> str | None:
    """Why nothing is to be expected of the extended model, in words; None where it predicts the record better than the
    run's own, or they cannot be compared.

    channel: that the run followed: the film's output, or "temperature_degC". Both models begin from what is fitted to
    the record's first rows. Raises Faults for a model that cannot be read."""
    after, before = (_error(path, record, channel) for path in (extended, own))
    if after is None or before is None or after.rmse < before.rmse:
        return None
    unit = after.unit
    told = f"to {after.rmse:.2g} {unit}, with the one that the run had to {before.rmse:.2g} {unit}"
    return f"with the extended model {after.what} of the run's own record is predicted {told}"


def _error(path: Path, record: Record, channel: str) -> ChannelError | None:
    model = read_model(path)
    if channel == "temperature_degC":  # the film has no part in it, and may not have been read
        model = replace(model, film=None)
    errors = errors_of(predicted(model, record, path, initial="fitted"), model, record)
    return next((error for error in errors if error.name == channel), None)
