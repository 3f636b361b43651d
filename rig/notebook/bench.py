"""A bench in a notebook, real or simulated: its output ends off, whatever happens in the block.

There is no guard process here, because a notebook's process cannot be forked. So real ports are opened only if the
controller's own dead man switches the output off when this process hangs or is killed. A long night is for
`peltier run` or the daemon, which have a guard.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from rig.analysis.error import Score
from rig.bench.assembly import Bench
from rig.bench.assembly import open_bench as assembled
from rig.config.configuration import ConfigurationFile, configuration_of
from rig.config.model_file import Model
from rig.config.toml_file import read_toml
from rig.core.faults import fault, in_python
from rig.core.outcome import NotConfirmedOff, Stopped, Tripped
from rig.core.reading import Identity, Reading
from rig.drivers.controller import TemperatureController
from rig.drivers.meter import LOG_RESISTANCE, ResistanceMeter, settled_reading
from rig.experiment import session
from rig.experiment.feasibility import target_and_model
from rig.experiment.run_record import Session
from rig.experiment.session import run_on
from rig.experiment.simulation import read_effects, simulated_configuration, simulated_rig
from rig.experiment.simulation import simulate as simulated
from rig.guard.pipe import UNGUARDED
from rig.guard.process import require_who_switches_off
from rig.records.record import Record
from rig.records.record_file import read_record
from rig.records.run_folder import default_folder, prepared_folder
from rig.report.run import write_live_report
from rig.safety.signals import NotebookStop, SignalStop

NO_FILE = Path("configuration")  # what messages call tables that stand in no file


Say = Callable[[str], None]


def tables_of(configuration: str | PathLike[str] | Mapping[str, Any]) -> tuple[Path, dict[str, Any]]:
    """Return the path of a configuration, and its tables, which are the caller's own. Raises Faults."""
    if isinstance(configuration, Mapping):
        return NO_FILE, deepcopy(dict(configuration))
    if isinstance(configuration, (str, PathLike)):
        path = Path(configuration)
        return path, read_toml(path)
    raise fault("configuration", "", f"expected a file's path or tables by name, not {type(configuration).__name__}")


def text_of(tables: Mapping[str, Any]) -> str:
    """Return tables as the text of a file. Raises Faults for what no file can have."""
    try:
        return tomli_w.dumps(tables)
    except (TypeError, ValueError) as error:
        raise fault(NO_FILE, "", str(error)) from None


@dataclass(frozen=True)
class BenchReading:
    """Readings of both instruments. time_s: on the bench's clock. temperature_degC and resistance_ohm: nan if the
    reading is no number, or the bench has no ohmmeter; thermometer and meter: the same with their quality."""

    time_s: float
    temperature_degC: float
    resistance_ohm: float
    thermometer: Reading
    meter: Reading | None


@dataclass(frozen=True, eq=False)
class Run:
    """An experiment that was run. folder: its run folder, with report.html in it; record: its rows; scores: how well
    each law followed a wanted resistance, decades; model: the one that it was run with, or that it calibrated."""

    folder: Path
    record: Record
    scores: tuple[Score, ...]
    model: Model | None


@dataclass(frozen=True, eq=False)
class OpenBench:
    """A bench whose instruments are open, and whose output is off unless something here switches it on.

    `run` and `calibrate` watch every limit of the configuration. controller, meter: the drivers themselves; through
    them nothing watches but the controller's own limits and its dead man.
    """

    identities: dict[str, Identity]
    controller: TemperatureController
    meter: ResistanceMeter | None
    _bench: Bench = field(repr=False)
    _file: ConfigurationFile = field(repr=False)
    _tables: Mapping[str, Any] = field(repr=False)

    def read(self) -> BenchReading:
        """Read both instruments, the meter when it has found its range; nothing is switched. Raises RigError."""
        thermometer = self.controller.read_temperature()
        shown = settled_reading(self.meter) if self.meter is not None else None
        ohmmeter = self.meter is not None and self.meter.output == LOG_RESISTANCE
        ohm = shown.value if shown is not None and shown.is_number and ohmmeter else math.nan
        degC = thermometer.value if thermometer.is_number else math.nan
        return BenchReading(thermometer.time_s, degC, ohm, thermometer, shown)

    @in_python()
    def run(self, out: Path | str | None = None, say: Say = lambda text: None, **experiment: Any) -> Run:
        """Run the configured experiment into a run folder; the output is off again when it returns.

        out: the folder, None: runs/DATE/TIME_NAME_ID. experiment: keys of the table [experiment] to change, as
        target=["start 50 kohm", "hold 10 s"]. say: called with what happens. Raises Faults, RigError, Outcome.
        """
        file = self._with(experiment)
        path = Path(out) if out is not None else default_folder(file.content.experiment.name)
        target, model = target_and_model(file, say)
        with prepared_folder(path), _interrupted() as signals:
            session = Session(self._bench, file, signals, say, report=write_live_report)
            result = run_on(session, path, target, model)
        record = read_record(result.folder / "record.csv")
        return Run(result.folder, record, tuple(result.scores), result.model)

    @in_python()
    def calibrate(self, out: Path | str | None = None, say: Say = lambda text: None) -> Run:
        """Measure film and plate with the configuration's [calibration]; `Run.model` is their model, which stands in
        the run folder as MODEL.toml. Raises as `run`."""
        path = Path(out) if out is not None else default_folder("calibration")
        with prepared_folder(path), _interrupted() as signals:
            found = session.calibrate(Session(self._bench, self._file, signals, say, report=write_live_report), path)
        return Run(path, read_record(path / "record.csv"), (), found.model)

    def _with(self, experiment: Mapping[str, Any]) -> ConfigurationFile:
        """Return the configuration with another experiment on the same bench. Raises Faults."""
        tables = {**self._tables, "experiment": {**self._tables.get("experiment", {}), **experiment}}
        return configuration_of(self._file.path, text_of(tables), tables)


@contextmanager
def open_bench(
    configuration: str | PathLike[str] | Mapping[str, Any], *, unguarded: bool = False
) -> Iterator[OpenBench]:
    """Open the instruments of a configuration, identified, their limits set; the output is off, confirmed, before the
    block and after it, whatever ends the block.

        with rig.open_bench("rig.toml") as bench:
            print(bench.read().temperature_degC)

    configuration: a file's path, or tables by name (`simulated_rig`). unguarded: open real ports also where the
    controller has no dead man. Ctrl-C raises KeyboardInterrupt, SIGTERM and SIGHUP SystemExit; while the output is
    being switched off they wait. Raises Faults, RigError (PortHeld: another process has the port), and NotConfirmedOff
    where the controller does not confirm that its output is off: switch it off by hand then.
    """
    with in_python():
        path, tables = tables_of(configuration)
        file = configuration_of(path, text_of(tables), tables, for_experiment=False)
    require_who_switches_off(file, UNGUARDED, unguarded)
    with NotebookStop() as signals:
        try:
            with assembled(file) as bench:
                try:
                    yield OpenBench(bench.identities, bench.controller, bench.meter, bench, file, tables)
                finally:
                    signals.shield()
        except NotConfirmedOff as error:
            error.add_note("OUTPUT NOT CONFIRMED OFF. Switch the controller off by hand.")
            raise
        signals.expose()


def run(
    configuration: str | PathLike[str] | Mapping[str, Any],
    out: Path | str | None = None,
    say: Say = lambda text: None,
    *,
    unguarded: bool = False,
    **experiment: Any,
) -> Run:
    """Run a configuration's experiment; the output is off, confirmed, when it returns. As `open_bench`, and in the
    block `OpenBench.run`, which say what the arguments are and what is raised."""
    with open_bench(configuration, unguarded=unguarded) as bench:
        return bench.run(out, say, **experiment)


def calibrate(
    configuration: str | PathLike[str] | Mapping[str, Any],
    out: Path | str | None = None,
    say: Say = lambda text: None,
    *,
    unguarded: bool = False,
) -> Run:
    """Measure film and plate with a configuration's [calibration]; `Run.model` is their model. The output is off,
    confirmed, when it returns. As `open_bench`, and in the block `OpenBench.calibrate`."""
    with open_bench(configuration, unguarded=unguarded) as bench:
        return bench.calibrate(out, say)


@contextmanager
def _interrupted() -> Iterator[SignalStop]:
    """End an experiment with the output off on a signal, and raise what a notebook expects of it."""
    try:
        with SignalStop() as signals:
            yield signals
    except Stopped as stopped:
        raise NotebookStop.outcome(stopped.number) from stopped


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated experiment. record: readings of the simulated instruments. effects: the parameters of each that was
    switched on, by names that bear their units. ended: the trip that ended the experiment
    early, None if it went to its end."""

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
    """Run a configuration's experiment in simulated time, whatever its ports; a current_profile without instruments.

    configuration: a file's path, tables by name, None: those of `simulated_rig`. effects: as on the command line,
    "film_lag:tau_s=2", with those of the configuration; a parameter that is left out takes the geometric mean of
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
