"""peltier run CONFIG [--out DIR]: an experiment; DIR is the run folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.daemon.handover import add_bench_argument, handed_over
from rig.guard.needed import add_unguarded_argument, guarded_where_needed, require_who_switches_off
from rig.guard.pipe import Guard


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
    """The imports are here, on the working process's side of the guard."""
    from rig.command.say import Voice
    from rig.config.configuration import read_configuration

    voice = Voice(options.json)
    file = read_configuration(options.config)
    require_who_switches_off(file, guard, options.unguarded)
    from rig.drivers.registry import controller_class
    from rig.experiment.session import run
    from rig.experiment.summaries import summary
    from rig.report.run import write_live_report
    from rig.safety.switching_off import off_confirmed

    with voice.progress(file.content.virtual_time) as progress:
        result = run(file, options.out, voice.say, progress, guard, write_live_report)
    calibration = result.calibration
    if calibration is not None:
        voice.say(f"model: {calibration.model_path}")
    voice.say(off_confirmed(controller_class(file.content.bench.controller.driver)))
    voice.say(f"report: {result.folder / 'report.html'}")
    voice.report(summary(result))
    return 0
