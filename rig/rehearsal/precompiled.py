"""Compiles ahead what identification, prediction, inversion and diagnosis would compile at their first use.

They are used on a record of the simulated rig, so that every loop is compiled for the arguments that it is called with.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rig.analysis.diagnosed import Asked, diagnosed
from rig.analysis.identified import AskedFit, identified
from rig.analysis.inverted import inverted
from rig.analysis.predicted import predicted
from rig.config.model_file import Model
from rig.records.record import Record
from rig.rehearsal.simulated import simulate, simulated_configuration, simulated_rig

HERE = Path("precompile")  # where messages would say that the configuration stands
PROFILE = ["start 1.1 A", "sine 1.2 A period 160 s for 160 s"]  # once through the transition of the template's film
EFFECTS: list[dict[str, Any]] = [  # one on each side of the film: their fits reach every loop
    {"name": "film_lag", "tau_s": 3.0},
    {"name": "series_resistance", "series_ohm": 300.0},
]
BUDGET_S = 20.0  # of the diagnosis: by then it has called each loop


def precompile() -> None:
    """Identify, predict, invert and diagnose a simulated record; its noise is independent from row to row, as an
    instrument's often is not."""
    record = _record()
    film = identified([record], AskedFit(), lambda text: None).model.film
    assert film is not None
    model = Model(film, diagnosed([record], Asked(budget_s=BUDGET_S))[1].plate)
    for initial in (None, "fitted"):
        predicted(model, record, HERE, initial=initial)
    inverted(film, np.array([3e4, 8e3, 1.5e4]), HERE)


def _record() -> Record:
    """Of the simulated rig, its plate driven by a known current."""
    tables = simulated_rig()
    tables["experiment"] = {"kind": "current_profile", "period_s": 0.5, "target": PROFILE}
    tables["simulation"]["first_degC"] = 45.0
    columns = simulate(simulated_configuration(HERE, tables, EFFECTS, None, ""), lambda text: None, None).columns
    return Record({name: np.asarray(values) for name, values in columns.items()}, str(HERE))
