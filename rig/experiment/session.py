"""One experiment from its configuration to its run folder: what `peltier run` and `peltier calibrate` do.

Order on every way out: output off and confirmed, rows flushed, reason written, report, exit status.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from compensator import listeners
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import LawName
from compensator.control.pid import Design, PidGains
from compensator.inverse.check import check_model
from compensator.precompile import FILM, PLATE, precompile
from compensator.thermal.plate import Kind
from rig.analysis.error import Score, target_error
from rig.analysis.prediction import needs_test_current
from rig.bench.assembly import open_bench, simulated_effects
from rig.config.configuration import Configuration, ConfigurationFile
from rig.config.model_file import Model, write_model
from rig.config.target import Target, target_column
from rig.control.decision import Onlooker, Phases, Policy
from rig.control.law_units import chain_observer, known_plate, plate_observer
from rig.control.loop import Loop
from rig.control.policies import Follow, Setpoints, warmed_up
from rig.core.faults import fault
from rig.drivers.controller import cools, drive_unit
from rig.drivers.meter import LOG_RESISTANCE, ResistanceMeter, column_of
from rig.experiment.calibration import Calibration, identify_calibration, record_calibration
from rig.experiment.feasibility import KINDS, TRACKING, check_feasible, expected_run, target_and_model
from rig.experiment.polarity import check_polarity
from rig.experiment.repetitions import LEARNED, USED, Learning, read_correction, write_correction
from rig.experiment.run_record import Report, Session, no_report, one_run, worked_out
from rig.experiment.tracking import design_document, law_and_design, plan_tracking, to_temperature, track
from rig.guard.pipe import UNGUARDED, Guard
from rig.records.record_file import write_columns
from rig.records.run_folder import PREDICTED, RunFolder, default_folder, part_of, prepared_folder
from rig.safety.plate_watch import watchable_rate_K_per_s
from rig.safety.signals import SignalStop
from sim.effects.actuator_delay import EFFECT as ACTUATOR_DELAY
from sim.effects.effect import switched
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG
from sim.inference.film.fit import identify_film
from sim.inference.plate.fit import identify_plate

LONG_S = 2.0  # from which its end is reported, too
PERIOD_S = 0.1


def compile_ahead(say: Callable[[str], None], calibrates: bool) -> None:
    """Compile the control law, and where a calibration is to come its fits and the laws behind a thermometer that lags;
    what is on disk already is loaded. say: called where it takes long."""
    began_s = time.monotonic()
    with _reported(say):
        precompile()
        if calibrates:
            _precompile_film_fit()
            _precompile_plate_fit()
            behind = [switched(ACTUATOR_DELAY, {"delay_s": PERIOD_S}), switched(SENSOR_LAG, {"tau_s": 1.0})]
            names: tuple[LawName, ...] = ("temperature", "full")
            for name in names:
                film = FILM if name == "full" else None
                settings = LawSettings(name, PERIOD_S, 4.0, 10.0, 95.0, PidGains(1.0, 0.1))
                law = warmed_up(Law(settings, PLATE, film, chain_observer(behind, PLATE, film, PERIOD_S)))
                law.late(law.start(25.0, None), 0.0, 0.5 * PERIOD_S)
    took_s = time.monotonic() - began_s
    if took_s > LONG_S:
        say(f"compiled in {took_s:.0f} s")


def _precompile_film_fit() -> None:
    """Fit a small film to two sweeps, and check it."""
    time_s = np.arange(150.0) * 0.4
    degC = 60.0 + 25.0 * np.sin(time_s * np.pi / 15.0)
    output, _ = FILM.simulate(degC, FILM.initial_memory(float(degC[0])))
    fit = identify_film(
        time_s, degC, output, kind="extended_generalized_pi", form="tanh", operators=2, initial="heated"
    )
    check_model(fit.model, 40.0, 80.0)


def _precompile_plate_fit() -> None:
    """Fit a plate to a minute of a current, read more and less often than it is simulated."""
    time_s = np.append(np.arange(0.0, 40.0, 0.4), np.arange(40.0, 60.0, 2.0))
    current_A = np.where(time_s < 20.0, 1.5, np.where(time_s < 40.0, -1.0, 0.0))
    identify_plate(time_s, PLATE.simulate(25.0, time_s, current_A), current_A, lag=True)


@contextmanager
def _reported(say: Callable[[str], None]) -> Iterator[None]:
    """Report through `say` that loops are compiled."""
    listeners.append(say)
    try:
        yield
    finally:
        listeners.remove(say)


BEYOND = 1.1  # of the target's ends: a film off by 0.04 decades still finds its range


@dataclass
class Result:
    """Result of an experiment, for report and JSON."""

    folder: Path
    calibration: Calibration | None = None
    scores: list[Score] = field(default_factory=list)
    repeated: list[Score] = field(default_factory=list)
    designs: dict[str, Design] = field(default_factory=dict)
    model: Model | None = None
    target: Target | None = None

    def document(self) -> dict[str, Any]:
        """Return the JSON of `peltier run`."""
        found = self.calibration
        return {
            "format": "peltier-run-result/1",
            "folder": self.folder,
            "scores": {score.law: score.table() for score in self.scores},
            "repeated": [score.table() for score in self.repeated],
            "designs": {name: design_document(design) for name, design in self.designs.items()},
            "calibration": found
            and {
                "model": found.model_path,
                "check_rmse_dec": found.check_rmse_dec,
                "rows_fitted": found.rows_fitted,
                "rows_checked": found.rows_checked,
            },
        }


def calibrate(session: Session, path: Path) -> Calibration:
    """Run the calibration into a folder, write MODEL.toml there and its report."""
    _say_dead_man(session)
    compile_ahead(session.say, calibrates=True)
    return _calibrated(session, path)


def _calibrated(session: Session, path: Path, inside: bool = False) -> Calibration:
    """Run a calibration on its own, or inside a run."""
    bench, file, say = session.bench, session.file, session.say
    if bench.meter is None:
        raise fault(file.path, "bench.meter", "missing; a calibration needs a meter")
    if bench.meter.output != LOG_RESISTANCE:
        raise fault(file.path, "bench.meter", f"reads {bench.meter.output}; a calibration needs an ohmmeter")
    _needs_current(session)
    with one_run(session, path, "calibration") as (loop, folder):
        allow_test_current(loop, file.content, file.content.limits.meter_current_A)
        check_polarity(loop, file.content, file.content.calibration.period_s)
        record_calibration(loop, file.content)
    say(f"calibration: {len(folder.rows)} rows; identifying film and plate")
    kind: Kind = "peltier" if cools(bench.controller) else "heater"
    with worked_out(folder):
        result = identify_calibration(folder, file.content, folder.part / "MODEL.toml", kind)
        if file.content.simulated:
            result = replace(result, intended=tuple(one.effect.changes for one in simulated_effects(file)))
        folder.result(**result.for_run_json())
        predicted = {"time_s": folder.column("time_s"), "predicted_ohm": 10.0**-result.predicted_output}
        write_columns(folder.part / PREDICTED, predicted)
        session.report(folder)
        whole = folder.finish()
    result = replace(result, model_path=whole / "MODEL.toml")
    for line in result.lines(whole=not inside):
        say(line)
    return result


def run(
    file: ConfigurationFile,
    out: Path | None,
    say: Callable[[str], None],
    onlooker: Onlooker | None,
    guard: Guard = UNGUARDED,
    report: Report = no_report,
) -> Result:
    """Run the experiment of a configuration on a bench that is opened for it. Raises Faults, RigError, Outcome."""
    path = out if out is not None else default_folder(file.content.experiment.name)
    target, model = target_and_model(file, say)
    with prepared_folder(path), SignalStop() as signals, open_bench(file, guard) as bench:
        signals.look()
        session = Session(bench, file, signals, say, onlooker or Onlooker(), report)
        expect(session, expected_run(file.content, target, model))
        return run_on(session, path, target, model)


def expect(session: Session, phases: Phases) -> None:
    """Let whoever shows how far it is know the phases to come."""
    meter, unit = session.bench.meter, drive_unit(session.bench.controller)
    session.onlooker.expect(phases, unit, column_of(meter.output) if meter is not None else "")


def run_on(session: Session, path: Path, target: Target, model: Model | None) -> Result:
    """Run the experiment on a bench that is open; target, model: as `target_and_model` gives them. Raises as `run`."""
    result = Result(path, model=model, target=target)
    meter = session.bench.meter
    kind = session.file.content.experiment.kind
    if kind == "track_resistance" and meter and meter.output != LOG_RESISTANCE:
        text = f"reads {meter.output}; expected an ohmmeter to track a resistance, or kind = 'track_output'"
        raise fault(session.file.path, "bench.meter", text)
    _say_dead_man(session)
    compile_ahead(session.say, calibrates=kind in TRACKING and model is None)
    if kind in TRACKING:
        _track_all(session, path, result)
    else:
        _profile(session, path, result)
    return result


def _track_all(session: Session, path: Path, result: Result) -> None:
    """Run a calibration if no model is given, the law, and the laws to compare it with; write the reports."""
    file, say = session.file, session.say
    e = file.content.experiment
    target, model = result.target, result.model
    assert target is not None
    inner = part_of(path)
    if model is None:
        result.calibration = _calibrated(session, inner / "calibration", inside=True)
        model = result.model = result.calibration.model
        check_feasible(file, target, model, say)
    assert model.film is not None
    assert model.plate is not None
    if e.law != "instrument_pid":
        _needs_current(session, model)
    folders: dict[LawName, RunFolder] = {}
    try:
        learning = _repetitions(session, inner, result)
        for name in e.laws:
            if name == e.law:
                folders[name] = _one_law(session, path, result, name, learning.next)
                learning.take(folders[name], target, learning.next, e.period_s)
                _keep_learned(folders[name], learning)
            else:
                folders[name] = _one_law(session, inner / name, result, name)
    except BaseException:
        with suppress(Exception):  # why it ended is more important
            _reports(session, folders, e.law)
        raise
    with worked_out(folders[e.law]):
        result.folder = _reports(session, folders, e.law).finish()
    if result.calibration is not None:
        moved = result.folder / "calibration" / "MODEL.toml"
        result.calibration = replace(result.calibration, model_path=moved)


def _repetitions(session: Session, inner: Path, result: Result) -> Learning:
    """Run all repetitions but the last, each in a folder of its own; return what was learned from them."""
    file, target = session.file, result.target
    assert target is not None
    e = file.content.experiment
    learning = Learning()
    if e.learned is not None:
        learning.next = read_correction(file.beside(e.learned) / LEARNED)
    for k in range(1, e.repeat):
        used = learning.next
        folder = _one_law(session, inner / f"repeat_{k}", result, e.law, used)
        learning.take(folder, target, used, e.period_s)
        _keep_learned(folder, learning)
        session.report(folder)
        folder.finish()
        result.repeated.append(result.scores.pop())
        if learning.over:
            session.say(f"repeat {k}: not better than {learning.best_rms_dec:.4f} dec: that correction is kept")
    return learning


def _keep_learned(folder: RunFolder, learning: Learning) -> None:
    """Write what a next repetition would add to its target into the run's folder."""
    if learning.next is not None:
        write_correction(folder.part / LEARNED, learning.next)


def _one_law(
    session: Session, where: Path, result: Result, name: LawName, correction: Target | None = None
) -> RunFolder:
    """Run one law on the target, into a folder of its own. correction: of the model."""
    file, target, model = session.file, result.target, result.model
    assert target is not None
    assert model is not None
    assert model.plate is not None
    e = file.content.experiment
    known = known_plate(model.plate, model.switched())
    plan = plan_tracking(file.content, target, model, name, watchable_rate_K_per_s(known))
    plan = replace(plan, model_lacks=correction)
    with one_run(session, where, f"law {name}") as (loop, folder):
        allow_test_current(loop, file.content, largest_test_current_A(loop.bench.meter, file.content, model, target))
        if name == e.law and result.calibration is None:
            check_polarity(loop, file.content, e.period_s, known)
        else:
            loop.know_plate(known)
        score = track(loop, file.content, plan)
    folder.result(law=name, score=score.table(), design=design_document(plan.design))
    _keep(folder, target, model)
    if correction is not None:
        write_correction(folder.part / USED, correction)
    if result.repeated:
        folder.result(repeated_rms_dec=[one.rms for one in result.repeated])
    result.scores.append(score)
    result.designs[name] = plan.design
    session.say(f"{name}: {score.in_words()}")
    return folder


def _reports(session: Session, folders: Mapping[LawName, RunFolder], own: LawName) -> RunFolder:
    """Write the reports: the laws to compare with first, for the own one's links to them; return the own folder."""
    for name, folder in folders.items():
        if name != own:
            session.report(folder)
            folder.finish()
    session.report(folders[own])
    return folders[own]


def _profile(session: Session, path: Path, result: Result) -> None:
    """Run a temperature or current over time."""
    file, say = session.file, session.say
    e, target = file.content.experiment, result.target
    assert target is not None
    plate = result.model.plate if result.model is not None else None
    film = result.model.film if result.model is not None else None
    known = known_plate(plate, result.model.switched()) if result.model is not None and plate is not None else None
    policy: Policy
    own = KINDS[e.kind].policy
    if e.law != "instrument_pid" or own is not None:
        _needs_current(session, result.model)
    if own is not None:
        policy = own(target, file.content)
    elif e.law == "instrument_pid":
        policy = Setpoints(target)
    else:
        assert plate is not None
        assert known is not None
        observer = plate_observer(result.model.switched() if result.model else (), plate, e.period_s)
        law, result.designs["temperature"] = law_and_design(
            "temperature", file.content, cast(Any, film), plate, observer, watchable_rate_K_per_s(known)
        )
        policy = Follow(law, target)
    with one_run(session, path, e.kind) as (loop, folder):
        allow_test_current(loop, file.content, file.content.limits.meter_current_A)
        check_polarity(loop, file.content, e.period_s, known)
        if isinstance(policy, Follow):
            start = to_temperature(loop, policy.law, None, float(target.values[0]), e.settle_s, "approach", False)
            policy.state = start.state
        loop.phase("profile", policy, target.duration_s, e.period_s)
    _keep(folder, target, result.model)
    error = target_error(folder)
    if error is not None:
        folder.result(error=error.document())
        say(f"temperature: RMS error {error.rms:.4f} K")
    with worked_out(folder):
        session.report(folder)
        result.folder = folder.finish()


def _keep(folder: RunFolder, target: Target, model: Model | None) -> None:
    """Write target and model into the run's folder, so that it is complete by itself."""
    values = 10.0**-target.values if target.quantity == "resistance" else target.values
    write_columns(folder.part / "target.csv", {"time_s": target.times_s, target_column(target.quantity): values})
    if model is not None:
        write_model(folder.part / "model.toml", model, "the model that the law used")


def _say_dead_man(session: Session) -> None:
    """Say who switches the output off when this program hangs: the controller itself, or nobody but the guard.

    And what its current is, where that is no current.
    """
    controller, name = session.bench.controller, session.file.content.bench.controller.driver
    if not controller.has_dead_man:
        rest = "the guard process stands in" if session.bench.guard.guarding else "nothing stands in for it"
        session.say(f"{name}: has no dead man of its own; {rest}")
    if not cools(controller):
        session.say(f"{name}: a heater, which cannot cool; current_A is its drive, 0 to 1 {drive_unit(controller)}")


def _needs_current(session: Session, model: Model | None = None) -> None:
    """Raise Faults if the controller cannot be given a current, or the model's plate is of another kind."""
    kind = "peltier" if cools(session.bench.controller) else "heater"
    if model is not None and model.plate is not None and model.plate.kind != kind:
        name = session.file.content.bench.controller.driver
        text = f"plate.kind {model.plate.kind!r}: expected {kind!r}, as {name!r} drives one"
        raise fault(session.file.path, "experiment.model", text)
    if not session.bench.controller.commands_current:
        table = session.file.content.bench.controller
        raise fault(
            session.file.path,
            "bench.controller.driver",
            f"{table.driver!r} takes no current; expected experiment.law = 'instrument_pid' with a model",
        )


def largest_test_current_A(
    meter: ResistanceMeter | None, configuration: Configuration, model: Model, target: Target
) -> float:
    """Return the largest test current (A) that a run on this target may have.

    An ohmmeter changes its test current with its range, by ten at a time, and a film that it heats by theta I^2 R
    jumps: by 0.3 K within a reading, at 3000 K/W, 0.1 mA and 10 kohm. The plate takes a tenth of a second and more to
    follow, and a film that jumps back has to cross its loop. So if the model has self-heating, the current with which
    the whole target can be read is kept. Else, or if no current is enough for all of it, it is the configured one; a
    user-defined meter that does not know such a current keeps its ranges.
    """
    most_A = configuration.limits.meter_current_A
    steady = getattr(meter, "steady_test_current_A", None)
    if steady is None or target.quantity != "resistance" or not needs_test_current(model.switched()):
        return most_A
    ohms = 10.0**-target.values
    current_A = float(steady(float(np.min(ohms)) / BEYOND, float(np.max(ohms)) * BEYOND, most_A))
    return most_A if math.isnan(current_A) else current_A


def allow_test_current(loop: Loop, configuration: Configuration, most_A: float) -> None:
    """Set the meter's ranges for this run if the run before had others. Raises RigError."""
    meter, table = loop.bench.meter, configuration.bench.meter
    if meter is None or table is None or meter.output != LOG_RESISTANCE:
        return
    if getattr(meter, "most_test_current_A", most_A) == most_A:
        return
    meter.configure(table.four_wire, table.nplc, most_A)
    loop.folder.event(loop.elapsed_s(), "test_current", f"at most {most_A:g} A")
