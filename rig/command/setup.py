"""Verbs of a set-up: init, precompile."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.core.faults import Faults, fault
from rig.core.file_writing import write_text

if TYPE_CHECKING:
    from rig.records.record import Record


TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
# The README's demo is a template, too. It stands in configs/ of a checkout; the wheel has it among the templates.
DEMO = TEMPLATES.parents[1] / "configs" / "demo.toml"


def init_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dir", type=Path, nargs="?", default=Path(), metavar="DIR")


def init(options: argparse.Namespace) -> int:
    """peltier init [DIR]: commented configurations to start from; existing files are left alone."""
    folder: Path = options.dir
    templates = sorted([*TEMPLATES.glob("*.toml"), *([DEMO] if DEMO.exists() else [])], key=lambda path: path.name)
    files = [folder / path.name for path in templates]
    there = [f"{file}: exists; expected a new file" for file in files if file.exists()]
    if there:
        raise Faults(there)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise fault(folder, "", "is a file; expected a folder") from None
    except OSError as error:
        raise fault(folder, "", f"no folder can be made here: {error.strerror}") from None
    for file, template in zip(files, templates, strict=True):
        write_text(file, template.read_text(encoding="utf-8"))
        print(file)
    return 0


HERE = Path("precompile")  # path of the configuration in messages
PROFILE = ["start 1.1 A", "sine 1.2 A period 160 s for 160 s"]  # once through the transition of the template's film
EFFECTS: list[dict[str, Any]] = [  # one on each side of the film: their fits reach every loop
    {"name": "film_lag", "tau_s": 3.0},
    {"name": "series_resistance", "series_ohm": 300.0},
]
BUDGET_S = 20.0  # of the diagnosis: by then it has called each loop


def precompile_arguments(parser: argparse.ArgumentParser) -> None:
    """Add no argument."""


def precompile(options: argparse.Namespace) -> int:
    """peltier precompile: compile the numerical code now, which is else compiled at its first use.

    This is the code of control law and simulated plate, and of identify, predict, invert and diagnose, which are run on
    a simulated record for that. It is kept on disk, so that the first command after a set-up or an update begins at
    once. `./peltier` does this in the background after a set-up.
    """
    import time

    from compensator.precompile import precompile

    began_s = time.monotonic()
    precompile()
    print(f"control law: compiled in {time.monotonic() - began_s:.1f} s", flush=True)
    precompile_analysis()
    print(f"all: compiled in {time.monotonic() - began_s:.1f} s")
    return 0


def precompile_analysis() -> None:
    """Identify, predict, invert and diagnose a simulated record, so that every loop is compiled for the arguments with
    which it is called. The record's noise is independent from row to row, as an instrument's often is not."""
    import numpy as np

    from rig.analysis.diagnosed import Asked, diagnosed
    from rig.analysis.identification import FitOptions, identified
    from rig.analysis.inversion import inverted
    from rig.analysis.prediction import predicted
    from rig.config.model_file import Model

    record = _simulated_record()
    film = identified([record], FitOptions(), lambda text: None).model.film
    assert film is not None
    model = Model(film, diagnosed([record], Asked(budget_s=BUDGET_S))[1].plate)
    for initial in (None, "fitted"):
        predicted(model, record, HERE, initial=initial)
    inverted(film, np.array([3e4, 8e3, 1.5e4]), HERE)


def _simulated_record() -> Record:
    """Return a record of the simulated rig, its plate driven by a known current."""
    import numpy as np

    from rig.experiment.simulation import simulate, simulated_configuration, simulated_rig
    from rig.records.record import Record

    tables = simulated_rig()
    tables["experiment"] = {"kind": "current_profile", "period_s": 0.5, "target": PROFILE}
    tables["simulation"]["first_degC"] = 45.0
    columns = simulate(simulated_configuration(HERE, tables, EFFECTS, None, ""), lambda text: None, None).columns
    return Record({name: np.asarray(values) for name, values in columns.items()}, str(HERE))
