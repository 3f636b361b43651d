"""peltier calibrate CONFIG [--out DIR]: measure film and plate with a profile that fixes both, write MODEL.toml."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.daemon.handover import add_bench_argument, handed_over
from rig.guard.pipe import Guard
from rig.guard.process import add_unguarded_argument, guarded_where_needed, require_who_switches_off


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="configuration of bench and calibration (TOML)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder; default runs/DATE/TIME_calibration_ID")
    add_bench_argument(parser)
    add_unguarded_argument(parser)
    parser.add_argument("--json", metavar="FILE", help="write the results as JSON; - is stdout")


def main(options: argparse.Namespace) -> int:
    status = handed_over("calibrate", options.config, options.out, options.json, options.bench)
    if status is not None:
        return status
    return guarded_where_needed(options.config, options.own_process, lambda guard: _calibrate(options, guard))


def _calibrate(options: argparse.Namespace, guard: Guard) -> int:
    """Do the work of the verb, in the process behind the guard, where its imports belong."""
    from rig.command.terminal import Terminal
    from rig.config.configuration import read_configuration
    from rig.records.run_folder import default_folder, prepared_folder

    terminal = Terminal(options.json)
    file = read_configuration(options.config, for_experiment=False)
    require_who_switches_off(file, guard, options.unguarded)
    from rig.bench.assembly import open_bench
    from rig.control.decision import Onlooker
    from rig.drivers.registry import controller_class
    from rig.experiment.phases import expected_calibration
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
