"""Whether an extended model tells the run that it was found in better than the model that the run had."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from rig.analysis.predicted import predicted
from rig.analysis.prediction_error import ChannelError, errors_of
from rig.config.model_file import Drive, read_model
from rig.records.record_file import Record
from sim.effects.catalogue import catalogue
from sim.inference.gain import gain

WORTH: Final = 0.1  # less error, by a fit alone: one of 50 numbers to 2,500 rows of noise gains 0.01 by itself
TEMPERATURE: Final = "temperature_degC"
BOTH: Final[tuple[Drive, Drive]] = ("temperature", "current")


def no_better(extended: Path, own: Path, record: Record, followed: str, new: Iterable[str]) -> str | None:
    """Why nothing is to be expected of the extended model, in words; None where it predicts the record better than the
    run's own, or they cannot be compared.

    followed: what the run followed: the film's output, or "temperature_degC". new: effects that the run's own has not,
    or has at another size. Those before the film have to tell the temperature better, since a film is told by the
    thermometer without them; any other one the film. Where both models have the same effects, `fitted_no_better`
    decides. Both begin from what is fitted to the record's first rows. Raises Faults for a model that cannot be read.
    """
    if names_of(read_model(extended).effects) == names_of(read_model(own).effects):
        return fitted_no_better(extended, own, record, followed)
    known = catalogue()
    before_film = all(name in known and known[name].before_film for name in new)
    after, before = _errors(extended, own, record, TEMPERATURE if before_film else followed)
    if after is None or before is None or after.rmse < before.rmse:
        return None
    return f"with the extended model {after.what} of the run's own record is predicted {_told(after, before)}"


def fitted_no_better(extended: Path, own: Path, record: Record, followed: str) -> str | None:
    """The same of a model whose effects are the run's own, maybe of other sizes: its film and plate are fitted to the
    run, where those of the run's own were fitted to a calibration. None where what was followed is told better by more
    than `WORTH`, whichever blocks of the record one looks at. Raises Faults for a model that cannot be read."""
    after, before = _errors(extended, own, record, followed)
    if after is None or before is None:
        return f"{followed} of the run's own record cannot be predicted by both models"
    if _less(before, after) > WORTH:
        return None
    return f"with film and plate fitted to the run {after.what} of its record is predicted {_told(after, before)}"


def names_of(effects: Iterable[Mapping[str, Any]]) -> set[str]:
    """Of effects as a model file, or a diagnosis, has them."""
    return {str(effect["name"]) for effect in effects}


def _errors(extended: Path, own: Path, record: Record, channel: str) -> tuple[ChannelError | None, ChannelError | None]:
    return _error(extended, record, channel), _error(own, record, channel)


def _told(after: ChannelError, before: ChannelError) -> str:
    return f"to {after.rmse:.2g} {after.unit}, with the one that the run had to {before.rmse:.2g} {after.unit}"


def _less(before: ChannelError, after: ChannelError) -> float:
    """Of the error, by share: the lower end of the 95 % interval."""
    first, second = (one.predicted - one.measured for one in (before, after))
    both = np.isfinite(first) & np.isfinite(second)
    return gain(first, second, both).reduction_ci95[0] if bool(np.any(both)) else 0.0


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
