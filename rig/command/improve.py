"""peltier improve RUN --config CONFIG: diagnose a run, extend its model, run again, say what it gained.

RUN is the folder of a run. Where its record names an effect that its model did not have, CONFIG's experiment runs again
with the diagnosis' model in experiment.model, and the errors of both runs are compared. Where none is named, but one
was found with which rows that no fit has seen are predicted better, that is tried: the second run judges it. It heats:
within the limits of CONFIG, which may not be wider than RUN's, and only after it has asked on the terminal, or with
--yes. Where nothing is found nothing is switched on. DIR has diagnosis/, config.toml (what runs), run/, report.html and
improvement.json.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.command.record_arguments import add_effect_file_argument
from rig.core.faults import fault
from rig.daemon.handover import add_bench_argument, handed_over
from rig.guard.pipe import Guard
from rig.guard.process import add_unguarded_argument, guarded_where_needed, require_who_switches_off

if TYPE_CHECKING:
    from rig.command.terminal import Terminal
    from rig.config.configuration import ConfigurationFile
    from rig.experiment.improvement import Improvable
    from rig.report.improvement import Improvement

SECOND = "run"


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of a run")
    parser.add_argument(
        "--config", type=Path, required=True, metavar="CONFIG", help="bench and experiment to run again"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="default runs/DATE/TIME_improve_ID")
    parser.add_argument("--yes", action="store_true", help="do not ask before the rig is heated")
    add_effect_file_argument(parser)
    add_bench_argument(parser)
    add_unguarded_argument(parser)
    parser.add_argument("--json", metavar="FILE", help="write the results as JSON; - is stdout")


def main(options: argparse.Namespace) -> int:
    if not options.yes and not sys.stdin.isatty():
        raise fault("--yes", "", "missing, and there is no terminal to ask on before the rig is heated; expected one")
    return guarded_where_needed(options.config, options.own_process, lambda guard: _improve(options, guard))


def _improve(options: argparse.Namespace, guard: Guard) -> int:
    """Do the work of the verb, in the process behind the guard, where its imports belong."""
    from rig.command.terminal import Terminal
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
    from rig.command.terminal import to_stderr
    from rig.core.faults import Faults
    from rig.experiment.improvement import as_effects, news
    from rig.records.record_file import read_record
    from rig.report.batch import CANDIDATE, MODEL
    from rig.report.diagnosis import Options, told
    from rig.report.improvement import Improvement

    folder, own = out / "diagnosis", tuple(path.absolute() for path in options.effect_file)
    record = read_record(found.run.part / "record.csv")
    first = target_error(found.run)

    how = Options(Asked(output=found.output), effect_files=own)
    said = told(record, how, str(folder / MODEL), report=True, say=lambda text: to_stderr(f"{record.source}: {text}"))
    if said.faults:
        raise Faults(said.faults)
    folder.mkdir(parents=True)
    said.write_files(folder)
    for line in said.lines:
        terminal.print(line)
    effects, tried = said.document["effects"], list[str]()
    new = news(effects, found.known)
    if not new and CANDIDATE in said.files:
        tried = news(as_effects(said.document["candidates"][0]), found.known)
    model = folder / (CANDIDATE if tried else MODEL)
    why_not = found.why_not(effects, new, tried) or found.no_better(model, record, effects, new or tried)
    seen = Improvement(options.run, out, found.law, said.document, said.lines[0], new, tried, model, first)
    return replace(seen, why_not=why_not, caveats=found.caveats)


def _extended(config: Path, improvement: Improvement) -> ConfigurationFile:
    """Write and read the configuration that will run. Raises Faults if the extended model cannot do it."""
    from rig.config.configuration import configuration_with_model, read_configuration
    from rig.core.file_writing import write_text
    from rig.experiment.feasibility import target_and_model

    path = improvement.folder / "config.toml"
    write_text(path, configuration_with_model(config, improvement.model))
    file = read_configuration(path)
    target_and_model(file, lambda text: None)
    return file


def _agreed(file: ConfigurationFile, terminal: Terminal) -> bool:
    """Return True if the user lets it heat."""
    from rig.experiment.feasibility import target_and_model
    from rig.experiment.phases import expected_run

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
    """Add the result of the second run."""
    from rig.analysis.error import target_error
    from rig.experiment.improvement import gain_of
    from rig.records.run_folder import recorded_run

    after = target_error(recorded_run(second))
    gain = gain_of(improvement.first, after) if found.comparable else None
    return replace(improvement, second=second, after=after, gained=gain)


def _report(improvement: Improvement, terminal: Terminal) -> None:
    """Report to the terminal, as a page and as JSON."""
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
