"""Touches the world: ports, clocks, files, people. And what a notebook needs, as `import rig`:

    record = rig.read_record("film.csv")          # or arrays by name, or a data frame
    found = rig.identify(record)                  # film, plate, transition, with error bars
    rig.predict(found, "other.csv"), rig.invert(found, [8e3, 12e3]), rig.diagnose(record)
    rig.simulate(tables), rig.run("rig.toml"), rig.open_bench("rig.toml")

docs/python.md is an hour with them. A name is loaded when it is first used, so that
`import rig` costs nothing.
"""

from __future__ import annotations

import sys
from importlib import import_module

from compensator import listeners

TYPE_CHECKING = False  # `typing` takes a quarter of Python's own start, and `peltier off` comes through here
if TYPE_CHECKING:
    from typing import Any

    from rig.config.model_file import Model as Model
    from rig.core.faults import Faults as Faults
    from rig.experiment.simulation import simulated_rig as simulated_rig
    from rig.notebook.analysis import diagnose as diagnose
    from rig.notebook.analysis import identify as identify
    from rig.notebook.analysis import invert as invert
    from rig.notebook.analysis import predict as predict
    from rig.notebook.bench import calibrate as calibrate
    from rig.notebook.bench import open_bench as open_bench
    from rig.notebook.bench import run as run
    from rig.notebook.bench import simulate as simulate
    from rig.notebook.files import read_model as read_model
    from rig.notebook.files import read_record as read_record
    from rig.notebook.files import write_model as write_model
    from rig.records.record import Record as Record
    from rig.version import __version__ as __version__
    from sim.effects.effect import Effect as Effect


def _to_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


listeners.append(_to_stderr)  # that loops are compiled
_PLACES = {
    "__version__": "version",
    "Effect": "sim.effects.effect",
    "Faults": "core.faults",
    "Model": "config.model_file",
    "Record": "records.record",
    "calibrate": "notebook.bench",
    "diagnose": "notebook.analysis",
    "identify": "notebook.analysis",
    "invert": "notebook.analysis",
    "open_bench": "notebook.bench",
    "predict": "notebook.analysis",
    "read_model": "notebook.files",
    "read_record": "notebook.files",
    "run": "notebook.bench",
    "simulate": "notebook.bench",
    "simulated_rig": "experiment.simulation",
    "write_model": "notebook.files",
}
__all__ = tuple(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'rig' has no attribute {name!r}")
    place = _PLACES[name]
    value = getattr(import_module(place if place.startswith("sim.") else f"rig.{place}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
