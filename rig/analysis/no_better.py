"""Whether an extended model tells the run that it was found in better than the model that the run had."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final

from rig.analysis.predicted import predicted
from rig.analysis.prediction_error import ChannelError, errors_of
from rig.files.model_file import Drive, read_model
from rig.files.record_file import Record
from sim.effects.catalogue import catalogue

TEMPERATURE: Final = "temperature_degC"
BOTH: Final[tuple[Drive, Drive]] = ("temperature", "current")


def no_better(extended: Path, own: Path, record: Record, followed: str, new: Iterable[str]) -> str | None:
    """Why nothing is to be expected of the extended model, in words; None where it predicts the record better than the
    run's own, or they cannot be compared.

    followed: what the run followed: the film's output, or "temperature_degC". new: effects that the run's own has not.
    Those before the film have to tell the temperature better, since a film is told by the thermometer without them; any
    other one the film. Both models begin from what is fitted to the record's first rows. Raises Faults for a model that
    cannot be read."""
    known = catalogue()
    before_film = all(name in known and known[name].before_film for name in new)
    channel = TEMPERATURE if before_film else followed
    after, before = (_error(path, record, channel) for path in (extended, own))
    if after is None or before is None or after.rmse < before.rmse:
        return None
    unit = after.unit
    told = f"to {after.rmse:.2g} {unit}, with the one that the run had to {before.rmse:.2g} {unit}"
    return f"with the extended model {after.what} of the run's own record is predicted {told}"


def _error(path: Path, record: Record, channel: str) -> ChannelError | None:
    """Of a film by what tells it best, the thermometer or the current: a model with effects would be told by the
    current alone, one without by the thermometer."""
    model = read_model(path)
    if channel == TEMPERATURE:  # the film has no part in it, and may not have been read
        model = replace(model, film=None)
    found = [
        error
        for drive in (BOTH[:1] if channel == TEMPERATURE else BOTH)
        for error in errors_of(predicted(model, record, path, initial="fitted", drive=drive), model, record)
        if error.name == channel
    ]
    return min(found, key=lambda error: error.rmse, default=None)
