"""peltier run CONFIG [--out DIR]: an experiment; DIR is the run folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.daemon.handover import add_bench_argument, handed_over
from rig.guard.pipe import Guard
from rig.guard.process import add_unguarded_argument, guarded_where_needed, require_who_switches_off


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="configuration of bench and experiment (TOML)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder; default runs/DATE/TIME_NAME_ID")
    add_bench_argument(parser)
    add_unguarded_argument(parser)
    parser.add_argument("--json", metavar="FILE", help="write the results as JSON; - is stdout")


def main(options: argparse.Namespace) -> int:
    status = handed_over("run", options.config, options.out, options.json, options.bench)
    if status is not None:
        return status
    return guarded_where_needed(options.config, options.own_process, lambda guard: _run(options, guard))


def _run(options: argparse.Namespace, guard: Guard) -> int:
    """Do the work of the verb, in the process behind the guard, where its imports belong."""
    from rig.command.terminal import Terminal
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
