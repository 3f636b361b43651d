"""The experiment of a configuration on the simulated rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.outcome import Tripped
from rig.core.python_words import in_python
from rig.notebook.configuration import tables_of, text_of
from rig.records.record import Record
from rig.rehearsal.simulated import read_effects, simulated_configuration, simulated_rig
from rig.rehearsal.simulated import simulate as simulated


@dataclass(frozen=True, eq=False)
class Simulation:
    """record: what the simulated instruments showed. effects: the parameters of each that was switched on, by names
    that bear their units. ended: the trip that ended the experiment early, None where it went to its end."""

    record: Record
    effects: dict[str, dict[str, float]]
    ended: Tripped | None


@in_python()
def simulate(
    configuration: str | PathLike[str] | Mapping[str, Any] | None = None,
    *,
    effects: Iterable[str] = (),
    effect_files: Iterable[Path | str] = (),
    seed: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Simulation:
    """A configuration's experiment in simulated time, whatever its ports are; a current_profile without instruments.

    configuration: a file's path, tables by name, None: those of `simulated_rig`. effects: as on the command line,
    "film_lag:tau_s=2", beside those of the configuration; a parameter that is left out takes the geometric middle of
    its usual sizes. seed: of the noise. say: called with what happens on the way. Raises Faults, RigError, Outcome.
    """
    path, tables = tables_of(simulated_rig() if configuration is None else configuration)
    switched = read_effects(list(effects), [Path(one) for one in effect_files])
    file = simulated_configuration(path, tables, switched, seed, text_of(tables))
    found = simulated(file, say, None)
    numbers = {name: np.asarray(c) for name, c in found.columns.items() if not isinstance(c, list)}
    text = {name: c for name, c in found.columns.items() if isinstance(c, list)}
    record = Record(numbers, source=f"simulation of {path}", text_columns=text)
    return Simulation(record, {e.effect.name: e.values() for e in found.effects}, found.ended)
