"""Verbs of an experiment: run, calibrate, simulate, improve, replay, report, tune."""

from __future__ import annotations

import argparse
import contextlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.command.record_arguments import add_effect_file_argument, add_json_argument, writable_file, writable_folder
from rig.command.terminal import Terminal, to_stderr
from rig.config.toml_file import shown
from rig.core.faults import fault
from rig.daemon.handover import add_bench_argument, handed_over
from rig.guard.pipe import Guard
from rig.guard.process import add_unguarded_argument, guarded_where_needed, require_who_switches_off

if TYPE_CHECKING:
    from compensator.control.pid import Design
    from rig.config.configuration import ConfigurationFile
    from rig.experiment.improvement import Improvable
    from rig.experiment.simulation import Simulated
    from rig.experiment.tuning import OwnTuning, WholeLaw
    from rig.records.run_folder import RunRows
    from rig.report.improvement import Improvement


def run_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="configuration of bench, experiment and calibration (TOML)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder; default runs/DATE/TIME_NAME_ID")
    _add_bench_arguments(parser)


calibrate_arguments = run_arguments


def _add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of each verb that heats: which daemon, without a guard, --json."""
    add_bench_argument(parser)
    add_unguarded_argument(parser)
    add_json_argument(parser)


def run(options: argparse.Namespace) -> int:
    """peltier run CONFIG [--out DIR]: an experiment; DIR is the run folder."""
    status = handed_over("run", options.config, options.out, options.json, options.bench)
    if status is not None:
        return status
    return guarded_where_needed(options.config, options.own_process, lambda guard: _run(options, guard))


def _run(options: argparse.Namespace, guard: Guard) -> int:
    """Do the work of the verb, in the process behind the guard, where its imports belong."""
    from rig.config.configuration import read_configuration

    terminal = Terminal(options.json)
    file = read_configuration(options.config)
    require_who_switches_off(file, guard, options.unguarded)
    from rig.drivers.registry import controller_class
    from rig.experiment.session import run
    from rig.report.run import write_live_report
    from rig.safety.switching_off import off_confirmed

    with terminal.progress(file.content.virtual_time) as progress:
        result = run(file, options.out, terminal.print, progress, guard, write_live_report)
    calibration = result.calibration
    if calibration is not None:
        terminal.print(f"model: {calibration.model_path}")
    terminal.print(off_confirmed(controller_class(file.content.bench.controller.driver)))
    terminal.print(f"report: {result.folder / 'report.html'}")
    terminal.write_json(result.document())
    return 0


def calibrate(options: argparse.Namespace) -> int:
    """peltier calibrate CONFIG [--out DIR]: measure film and plate with a profile that fixes both, write MODEL.toml."""
    status = handed_over("calibrate", options.config, options.out, options.json, options.bench)
    if status is not None:
        return status
    return guarded_where_needed(options.config, options.own_process, lambda guard: _calibrate(options, guard))


def _calibrate(options: argparse.Namespace, guard: Guard) -> int:
    """Do the work of the verb, in the process behind the guard, where its imports belong."""
    from rig.config.configuration import read_configuration
    from rig.records.run_folder import default_folder, prepared_folder

    terminal = Terminal(options.json)
    file = read_configuration(options.config, for_experiment=False)
    require_who_switches_off(file, guard, options.unguarded)
    from rig.bench.assembly import open_bench
    from rig.control.decision import Onlooker
    from rig.drivers.registry import controller_class
    from rig.experiment.feasibility import expected_calibration
    from rig.experiment.run_record import Session
    from rig.experiment.session import calibrate, expect
    from rig.report.run import write_live_report
    from rig.safety.signals import SignalStop
    from rig.safety.switching_off import off_confirmed

    path = options.out if options.out is not None else default_folder("calibration")
    with (
        prepared_folder(path),
        terminal.progress(file.content.virtual_time) as progress,
        SignalStop() as signals,
        open_bench(file, guard) as bench,
    ):
        signals.look()
        session = Session(bench, file, signals, terminal.print, progress or Onlooker(), write_live_report)
        expect(session, expected_calibration(file.content))
        result = calibrate(session, path)
    terminal.print(off_confirmed(controller_class(file.content.bench.controller.driver)))
    terminal.print(f"model: {result.model_path}")
    terminal.print(f"report: {path / 'report.html'}")
    terminal.write_json(result.document())
    return 0


def simulate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[:param=value,...]",
        help="switch an effect of the catalogue on, as in film_lag:tau_s=3 (repeatable)",
    )
    add_effect_file_argument(parser, ", to be switched on by --effect")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the noise; default: as configured")
    parser.add_argument("--out", type=writable_file, required=True, metavar="RECORD.csv")
    add_json_argument(parser)


def simulate(options: argparse.Namespace) -> int:
    """peltier simulate CONFIG [--effect NAME[:param=value,...]]... --out RECORD.csv: simulate the experiment.

    The configured experiment runs on simulated instruments in virtual time, whatever its ports are; a current_profile
    runs without instruments, so that its rows are exact. Effects of --effect are added to those of the configuration; a
    parameter that is left out takes the geometric mean of its typical sizes.
    """
    from rig.experiment.simulation import read_simulation

    terminal = Terminal(options.json)
    file = read_simulation(options.config, options.effect, options.effect_file, options.seed)
    simulated = _simulated(file, options.out, terminal)
    for effect in simulated.effects:
        parameters = ", ".join(f"{name} = {value:g}" for name, value in effect.values().items())
        terminal.print(f"{effect.name}: {parameters}")
    terminal.write_json(
        {
            "format": "peltier-simulation/1",
            "record": options.out,
            "rows": simulated.rows,
            "seed": file.content.simulation.seed,
            "effects": [{"name": e.name, "parameters": e.values()} for e in simulated.effects],
        }
    )
    if simulated.ended is not None:
        raise simulated.ended
    return 0


def _simulated(file: ConfigurationFile, out: Path | None, terminal: Terminal) -> Simulated:
    """Run a configuration's experiment on the simulated rig, and write its record."""
    from rig.experiment.simulation import simulate
    from rig.records.record_file import write_columns

    with terminal.progress(virtual=True) as progress:
        simulated = simulate(file, to_stderr, progress)
    if out is not None:
        write_columns(out, simulated.columns)
        terminal.print(f"record: {out}, {simulated.rows} rows")
    return simulated


SECOND = "run"


def improve_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of a run")
    parser.add_argument(
        "--config", type=Path, required=True, metavar="CONFIG", help="bench and experiment to run again"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="default runs/DATE/TIME_improve_ID")
    parser.add_argument("--yes", action="store_true", help="do not ask before the rig is heated")
    add_effect_file_argument(parser)
    _add_bench_arguments(parser)


def improve(options: argparse.Namespace) -> int:
    """peltier improve RUN --config CONFIG: diagnose a run, extend its model, run again, say what it gained.

    RUN is the folder of a run. Where its record names an effect that its model did not have, CONFIG's experiment runs
    again with the diagnosis' model in experiment.model, and the errors of both runs are compared. Where none is named,
    but one was found with which rows that no fit has seen are predicted better, that is tried: the second run judges
    it. It heats: within the limits of CONFIG, which may not be wider than RUN's, and only after it has asked on the
    terminal, or with --yes. Where nothing is found nothing is switched on. DIR has diagnosis/, config.toml (what runs),
    run/, report.html and improvement.json.
    """
    if not options.yes and not sys.stdin.isatty():
        raise fault("--yes", "", "missing, and there is no terminal to ask on before the rig is heated; expected one")
    return guarded_where_needed(options.config, options.own_process, lambda guard: _improve(options, guard))


def _improve(options: argparse.Namespace, guard: Guard) -> int:
    """Do the work of the verb, in the process behind the guard, where its imports belong."""
    from rig.config.effect_tables import add_effect_files
    from rig.experiment.improvement import improvable
    from rig.records.run_folder import check_free, default_folder

    terminal = Terminal(options.json)
    add_effect_files(options.effect_file)
    found = improvable(options.run, options.config)
    require_who_switches_off(found.file, guard, options.unguarded)
    out = options.out if options.out is not None else default_folder("improve")
    check_free(out)
    improvement = _diagnosed(options, found, out, terminal)
    if improvement.why_not is None:
        extended = _extended(options.config, improvement)
        if options.yes or _agreed(extended, terminal):
            status = _run_again(options, extended, out / SECOND, guard, terminal)
            if status != 0:
                return status
            improvement = _compared(improvement, found, out / SECOND)
        else:
            improvement = replace(improvement, why_not="you said no")
    _report(improvement, terminal)
    return 0


def _diagnosed(options: argparse.Namespace, found: Improvable, out: Path, terminal: Terminal) -> Improvement:
    """Diagnose RUN, and write the report of that. Raises Faults if nothing can be said of its record."""
    from rig.analysis.diagnosed import Asked
    from rig.analysis.error import target_error
    from rig.core.faults import Faults
    from rig.experiment.improvement import as_effects, news
    from rig.records.record_file import read_record
    from rig.report.batch import CANDIDATE, MODEL
    from rig.report.diagnosis import report_diagnosis
    from rig.report.improvement import Improvement

    folder, own = out / "diagnosis", tuple(path.absolute() for path in options.effect_file)
    record = read_record(found.run.part / "record.csv")
    first = target_error(found.run)

    how = Asked(output=found.output, effect_files=own)
    done = report_diagnosis(
        record, how, str(folder / MODEL), report=True, say=lambda text: to_stderr(f"{record.source}: {text}")
    )
    if done.faults:
        raise Faults(done.faults)
    folder.mkdir(parents=True)
    done.write_files(folder)
    for line in done.lines:
        terminal.print(line)
    effects, tried = done.document["effects"], list[str]()
    new = news(effects, found.known)
    if not new and CANDIDATE in done.files:
        tried = news(as_effects(done.document["candidates"][0]), found.known)
    model = folder / (CANDIDATE if tried else MODEL)
    why_not = found.why_not(effects, new, tried) or found.no_better(model, record, effects, new or tried)
    seen = Improvement(options.run, out, found.law, done.document, done.lines[0], new, tried, model, first)
    return replace(seen, why_not=why_not, caveats=found.caveats)


def _extended(config: Path, improvement: Improvement) -> ConfigurationFile:
    """Write and read the configuration that will run. Raises Faults if the extended model cannot do it."""
    from rig.config.configuration import read_configuration
    from rig.config.toml_file import configuration_with_model
    from rig.core.file_writing import write_text
    from rig.experiment.feasibility import target_and_model

    path = improvement.folder / "config.toml"
    write_text(path, configuration_with_model(config, improvement.model))
    file = read_configuration(path)
    target_and_model(file, lambda text: None)
    return file


def _agreed(file: ConfigurationFile, terminal: Terminal) -> bool:
    """Return True if the user lets it heat."""
    from rig.experiment.feasibility import expected_run, target_and_model

    c = file.content
    minutes = sum(seconds for _, seconds in expected_run(c, *target_and_model(file, lambda text: None))) / 60.0
    low, high = c.limits.temperature_degC
    controller = c.bench.controller
    terminal.print(
        f"It heats: {controller.driver} at {controller.port}, about {minutes:.1f} min, "
        f"limits {low:g} to {high:g} degC and {c.limits.current_A:g} A. Run {file.path}? [y/N]"
    )
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _run_again(
    options: argparse.Namespace, file: ConfigurationFile, out: Path, guard: Guard, terminal: Terminal
) -> int:
    """Run as `peltier run` does; return the exit status if a daemon ran it, else 0. Raises what ends a run."""
    from rig.experiment.session import run
    from rig.report.run import write_live_report

    with contextlib.redirect_stdout(sys.stderr) if options.json == "-" else contextlib.nullcontext():
        status = handed_over("run", file.path, out, None, options.bench)
    if status is not None:
        return status
    try:
        with terminal.progress(file.content.virtual_time) as progress:
            run(file, out, terminal.print, progress, guard, write_live_report)
    except BaseException as error:
        error.add_note(f"the diagnosis is in {out.parent / 'diagnosis'}")
        raise
    return 0


def _compared(improvement: Improvement, found: Improvable, second: Path) -> Improvement:
    from rig.analysis.error import target_error
    from rig.experiment.improvement import gain_of
    from rig.records.run_folder import recorded_run

    after = target_error(recorded_run(second))
    gain = gain_of(improvement.first, after) if found.comparable else None
    return replace(improvement, second=second, after=after, gained=gain)


def _report(improvement: Improvement, terminal: Terminal) -> None:
    from rig.core.file_writing import write_text
    from rig.records.run_folder import plain_json
    from rig.report.improvement import lines, write_improvement

    write_improvement(improvement)
    write_text(improvement.folder / "improvement.json", plain_json(improvement.document()) + "\n")
    for line in lines(improvement):
        terminal.print(line)
    terminal.print(f"model: {improvement.model}")
    terminal.print(f"report: {improvement.folder / 'report.html'}")
    terminal.write_json(improvement.document())


def replay_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of a run")
    parser.add_argument("--config", type=Path, metavar="OTHER.toml", help="another configuration, on the run's twin")
    parser.add_argument("--out", type=writable_file, metavar="RECORD.csv", help="with --config: its record")
    add_json_argument(parser)


def replay(options: argparse.Namespace) -> int:
    """peltier replay RUN [--config OTHER.toml]: the law again over a recorded run.

    The run's readings go into its law once more, and every command is compared bit for bit with the one that was sent.
    They are the same for the version that made the run; for another one it is said which, and bits may differ.
    A user-defined law (docs/own_law.md) is the file that the run folder keeps of it.
    With --config, another configuration runs on the run's twin instead: a simulated rig with the film, plate and
    effects of the run's model.toml.
    """
    from rig.experiment.replay import replay_run

    terminal = Terminal(options.json)
    if options.config is not None:
        return _twin(options, terminal)
    replay = replay_run(options.run)
    same = replay.compared - replay.different
    terminal.print(f"{same} of {replay.compared} commands are the same, bit for bit")
    for name, (then, now) in replay.other_versions.items():
        terminal.print(f"the run was made with {name} {then}, this is {now}: bits may differ")
    if replay.different:
        terminal.print(f"largest difference {replay.largest:.3g}, the first at {replay.first_different_s:g} s")
    terminal.write_json({"format": "peltier-replay/1", "run": options.run, **replay.__dict__})
    return 0 if replay.different == 0 else 1


def _twin(options: argparse.Namespace, terminal: Terminal) -> int:
    from rig.analysis.error import target_error
    from rig.experiment.replay import twin_configuration

    simulated = _simulated(twin_configuration(options.run, options.config), options.out, terminal)
    found = target_error(simulated)
    error = found.document() if found is not None else {}
    for name, value in error.items():
        terminal.print(f"{name}: {value:.4g}")
    terminal.write_json({"format": "peltier-replay/1", "run": options.run, "configuration": options.config, **error})
    if simulated.ended is not None:
        raise simulated.ended
    return 0


def report_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the folder of a run, or of a calibration")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where the report goes; default: FOLDER itself")


def report(options: argparse.Namespace) -> int:
    """peltier report FOLDER [--out DIR]: the report of a run folder, written anew; of one that ended early too.

    FOLDER is what `run` or `calibrate` wrote, DIR or DIR.part. report.html and figures/ go there, or to --out DIR. Of a
    run that ended before its own rows began, as while it calibrated, the runs inside FOLDER are reported, each in its
    place.
    """
    from rig.records.run_folder import recorded_inside, recorded_run

    inside = recorded_inside(options.folder)
    if not inside:
        run = recorded_run(options.folder)
        print(_written(run, _made(options.out) if options.out is not None else options.folder))
        return 0
    names = ", ".join(run.part.name for run in inside)
    text = f"no run.json: the run ended before its own rows began; reported is what it had recorded until then: {names}"
    print(f"{options.folder}: {text}", file=sys.stderr)
    for run in inside:
        print(_written(run, _made(options.out / run.path.name) if options.out is not None else run.part))
    return 0


def _written(run: RunRows, out: Path) -> Path:
    """Write the page of a run into a folder that is there; return its path. Raises Faults."""
    from rig.report.run import write_run_report

    try:
        write_run_report(run, out)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise fault(run.part / "run.json", "", f"is not that of a run ({shown(what)}); expected a run folder") from None
    except OSError as error:
        raise fault(out, "", f"cannot be written: {error.strerror or error}") from None
    return out / "report.html"


def _made(out: Path) -> Path:
    """Make a folder if it is missing. Raises Faults."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise fault(out, "--out", f"cannot be made: {error.strerror or error}") from None
    return out


def tune_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    parser.add_argument(
        "--output-age", type=float, metavar="S", help="how long before the thermometer the ohmmeter is read"
    )
    parser.add_argument("--acts-after", type=float, metavar="S", help="how long after a reading its command acts")
    text = "report.html, figures and tuning.json there"
    parser.add_argument("--report", type=writable_folder, metavar="DIR", help=text)
    add_json_argument(parser)


def tune(options: argparse.Namespace) -> int:
    """peltier tune CONFIG: gains from the plate model, and the margins of the whole law with them.

    The whole law is estimator, resistance feedback through the inverse, temperature PID, delays, plate and film; the
    film's slope is taken as 0.6 to 2.2 times the model's. Gains with too small margins are refused (exit status 1),
    with a line on what to lower.
    """
    from rig.config.configuration import read_configuration
    from rig.config.model_file import read_model
    from rig.experiment.tracking import design_document, law_and_design, timing_of
    from rig.experiment.tuning import law_table, own_table, own_tuning, tuned_law
    from rig.records.film_output import column_of, in_decades, unit_of

    terminal = Terminal(options.json)
    file = read_configuration(options.config)
    configuration = file.content
    if configuration.experiment.model is None:
        raise fault(
            options.config,
            "experiment.model",
            "missing; expected a model file with [plate] and [film], as `peltier calibrate` writes",
        )
    model = read_model(file.beside(configuration.experiment.model), needs=("plate", "film"))
    assert model.film is not None
    assert model.plate is not None
    for flag, value in (("--output-age", options.output_age), ("--acts-after", options.acts_after)):
        if value is not None and not 0.0 <= value <= configuration.experiment.period_s:
            raise fault("the command line", flag, f"{value:g} s: expected 0 to a period")
    timing = timing_of(configuration, options.output_age, options.acts_after)
    own = own_tuning(configuration, model.film, model.plate)
    chosen = configuration.experiment.law
    name = chosen if chosen == "instrument_pid" else "full"
    found, design = tuned_law(configuration, model, name, timing)
    _, by_output = law_and_design("pid", configuration, model.film, model.plate)
    if name == "full":
        _print_gains(terminal, "full: PID on temperature, output in K/s", design, ("1/s", "1/s^2"))
    _print_margins(terminal, found)
    unit = "A" if model.plate.kind == "peltier" else "of full drive"
    output = model.film.output
    what, per = "log R" if in_decades(output) else column_of(output), unit_of(output)
    _print_gains(
        terminal, f"pid: PID on {what} alone, output in {unit}", by_output, (f"{unit}/{per}", f"{unit}/({per} s)")
    )
    _print_own_pid(terminal, own, configuration.bench.controller.driver)
    result = {
        "format": "peltier-tuning/2",
        name: {**design_document(design), "whole_law": law_table(found)},
        "pid": design_document(by_output),
        "instrument_pid_gains": own_table(own),
        "refused": found.refused,
    }
    if options.report is not None:
        from rig.report.tuning import write_tuning_report

        options.report.mkdir(exist_ok=True)
        write_tuning_report(options.report, options.config.name, result, found)
        terminal.print(f"report: {options.report / 'report.html'}")
    terminal.write_json(result)
    for line in found.refused:
        print(f"{options.config}: refused: {line}", file=sys.stderr)
    return 1 if found.refused else 0


def _print_gains(terminal: Terminal, title: str, design: Design, units: tuple[str, str]) -> None:
    """Print gains and margins of a PID alone. units: of Kp and Ki."""
    gains, margins = design.gains, design.margins
    terminal.print(f"{title}, period {design.period_s:g} s, dead time {design.dead_time_s:g} s")
    k_p, k_i = f"Kp {gains.kp:.5g} {units[0]}", f"Ki {gains.ki:.5g} {units[1]}"
    terminal.print(f"  {k_p}   {k_i}   tracking time {gains.tracking_time_s:.3g} s")
    terminal.print(
        f"  this loop alone: gain margin {margins.gain_margin:.2f}   phase margin {margins.phase_margin_deg:.1f} deg   "
        f"Ms {margins.ms:.3f}   crossover {margins.crossover_rad_per_s:.3g} rad/s"
    )


def _print_margins(terminal: Terminal, found: WholeLaw) -> None:
    t = found.timing
    terminal.print(
        f"{found.name}: the whole law (estimator, resistance through the inverse, temperature, delays, plate, film),\n"
        "  the smallest margins over heating and cooling branch"
    )
    terminal.print(
        f"  one reading of the ohmmeter corrects at most {found.most_share:.2f} of its error;\n"
        f"  it is read {1e3 * t.output_age_s:.0f} ms before the thermometer, "
        f"a command acts {1e3 * t.acts_after_s:.0f} ms after it"
        + (f" and {1e3 * t.late_s:.0f} ms that no stamp shows" if t.late_s else "")
    )
    terminal.print("  film's slope over   gain    phase margin   Ms of      Ms, at        Ms, at     disk margin")
    terminal.print("  the model's         margin  deg            the law    thermometer   ohmmeter   gain x, phase deg")
    for row in found.rows:
        m = row.margins
        if not m.stable:
            terminal.print(f"  {row.ratio:<19g} unstable ({row.way}, {row.degC:.1f} degC)")
            continue
        terminal.print(
            f"  {row.ratio:<19g} {m.gain_margin:<7.2f} {m.phase_margin_deg:<14.0f} {m.ms:<10.2f} "
            f"{_or_dash(m.at_thermometer):<13} {m.at_ohmmeter:<10.2f} {m.disk_gain:.2f}, {m.disk_phase_deg:.0f}"
        )
    terminal.print(
        f"  unstable with a film {_times(found.rings_at_ratio)} as steep as the model's, "
        f"or a plate whose gain is {_times(found.rings_at_gain)} the model's"
    )
    rest = found.rest
    terminal.print(
        f"  film at rest, within the band where the resistance is not fed back: gain margin {rest.gain_margin:.2f}, "
        f"Ms {rest.ms:.2f}"
    )


def _or_dash(value: float) -> str:
    return "-" if value != value else f"{value:.2f}"


def _times(ratio: float) -> str:
    return "more than 100 times" if ratio == float("inf") else f"{ratio:.2f} times"


def _print_own_pid(terminal: Terminal, own: OwnTuning, driver: str) -> None:
    pid, margins = own.pid, own.design.margins
    terminal.print(
        f"the controller's own PID (law instrument_pid): Kp {pid.kp_A_per_K:.4g} A/K, Ti {pid.ti_s:.3g} s, "
        f"Td {pid.td_s:.3g} s; Ms {margins.ms:.2f}"
    )
    if own.fields is None:
        terminal.print(f"  {driver}: the program does not know its fields")
        return
    listed = ", ".join(f"{field.option} = {field.value:g}" for field in own.fields)
    terminal.print(f"  [bench.controller] options = {{ {listed} }}")
    for command in dict.fromkeys(field.command for field in own.fields):
        terminal.print(f"  or at the instrument: {command}")
