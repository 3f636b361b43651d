"""peltier diagnose RECORD...: find the effects that the simulation of the rig lacks, and their sizes.

The base model (plate and film) is fitted to the record, then effects of the catalogue with it. Those that the record
needs are named, with the errors in held-out rows with and without them. A residual that no effect explains is called
unexplained. Without resistance only driver, plate and thermometer are diagnosed; without current, film and ohmmeter.

Several records are diagnosed one by one. --report DIR then has a folder for each, and tables of all: report.html,
diagnoses.csv and diagnoses.nc. After an interruption the same command continues with the missing records. With --joint
records of one rig are fitted together: only room, first temperatures and film memory are fitted for each record.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.batch import is_of_many
from rig.command.batch import add_engine_arguments, report_each
from rig.command.record_arguments import (
    add_effect_file_argument,
    add_json_argument,
    add_output_argument,
    add_record_arguments,
    read_each,
    read_records,
    writable_file,
    writable_folder,
)
from rig.command.terminal import Terminal
from rig.core.faults import Faults, fault
from rig.records.record_file import Record

if TYPE_CHECKING:
    from rig.report.diagnosis import Options


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    text = "fit several records of one rig together: one plate, one film, the same effects; a room for each"
    parser.add_argument("--joint", action="store_true", help=text)
    add_record_arguments(parser)
    add_output_argument(parser)
    parser.add_argument(
        "--model", type=Path, metavar="MODEL.toml", help="if its film has no D(T), the base model has none either"
    )
    parser.add_argument(
        "--base",
        choices=["extended_generalized_pi", "generalized_pi"],
        help="the film's base model; generalized_pi: without D(T), unless the record needs one",
    )
    parser.add_argument("--plate", choices=["peltier", "heater"], help="kind of plate; default: what the drive allows")
    text = "compute the errors on this other record of the rig (repeatable)"
    parser.add_argument("--holdout", type=Path, metavar="RECORD", action="append", default=[], help=text)
    parser.add_argument(
        "--initial",
        choices=["cooled", "heated", "fitted"],
        default="fitted",
        help="without effect: the film's memory at the first row is always fitted",
    )
    add_effect_file_argument(parser)
    parser.add_argument(
        "--assume",
        action="append",
        default=[],
        metavar="NAME[:param=value]",
        help="a known effect, with its known parameters (repeatable)",
    )
    text = "time for a record; the best result until then is reported"
    parser.add_argument("--budget", type=float, metavar="SECONDS", help=text)
    text = "share of records without any effect in which one may be named (default 0.01)"
    parser.add_argument("--false-alarm", type=float, metavar="SHARE", help=text)
    text = "fit room, first temperatures and memory of a held-out record to its first SECONDS (default 30)"
    parser.add_argument("--first", type=float, metavar="SECONDS", help=text)
    parser.add_argument("--report", type=Path, metavar="DIR", help="report.html, diagnosis.json and model.toml there")
    parser.add_argument("--out", type=Path, metavar="MODEL.toml", help="the extended model")
    add_engine_arguments(parser)
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    of_many = is_of_many(options.report)
    if of_many and options.joint:
        raise fault("--report", str(options.report), "has the table of many records; expected another DIR for --joint")
    several = not options.joint and (len(options.records) > 1 or of_many)  # one more of them, as well
    if options.out is not None:
        if several:
            expected = "expected a single RECORD, none of many; --report DIR writes a model for each"
            raise fault("--out", str(options.out), expected)
        writable_file(options.out)
    if options.report is not None:
        writable_folder(options.report)
    terminal = Terminal(options.json)
    if options.effect_file:
        from rig.config.effect_tables import add_effect_files

        add_effect_files(options.effect_file)
    if options.budget is not None and not options.budget > 0.0:
        raise fault("--budget", f"{options.budget:g}", "expected a number of seconds > 0")
    if options.first is not None and not options.holdout:
        raise fault("--first", f"{options.first:g}", "expected --holdout RECORD with it: nothing else is predicted")
    if options.false_alarm is not None:
        from sim.inference.evidence import FALSE_ALARMS

        if not FALSE_ALARMS[0] <= options.false_alarm <= FALSE_ALARMS[1]:
            expected = f"expected a share from {FALSE_ALARMS[0]:g} to {FALSE_ALARMS[1]:g}"
            raise fault("--false-alarm", f"{options.false_alarm:g}", expected)
    if options.assume:
        from rig.config.effect_tables import parse_assumed_effects

        parse_assumed_effects(options.assume)
    base = _base(options)
    if options.initial != "fitted":
        print("--initial: the film's memory is fitted with the record", file=sys.stderr)
    each = read_each(options.records, options) if several else []
    records = [] if several else read_records(options.records, options)
    holdout = read_records(options.holdout, options) if options.holdout else []
    from rig.analysis.diagnosed import Asked  # seconds: after what may be refused has been read
    from rig.report.diagnosis import Options

    own = tuple(path.absolute() for path in options.effect_file)
    asked = Options(
        Asked(base, options.output, options.plate, None, options.budget, options.false_alarm, options.first),
        tuple(options.assume),
        own,
    )
    if several:
        from rig.report.diagnosis import diagnoses

        return report_each(each, diagnoses(asked, holdout), options, terminal)
    terminal.write_json(_single(records, asked, holdout, options, terminal))
    return 0


def _base(options: argparse.Namespace) -> str | None:
    """The base of --base, or that of the model."""
    if options.base is not None:
        return str(options.base)
    if options.model is None:
        return None
    from rig.config.model_file import read_model

    film = read_model(options.model).film
    if film is None or film.memoryless.function != "none":
        return None
    print(f"{options.model}: its film has no D(T): base generalized_pi", file=sys.stderr)
    return "generalized_pi"


def _single(
    records: list[Record], asked: Options, holdout: list[Record], options: argparse.Namespace, terminal: Terminal
) -> dict[str, Any]:
    """One record, or several as one, with progress on stderr; its document. Raises Faults."""
    from rig.report.batch import MODEL
    from rig.report.diagnosis import told

    record, *further = records

    def say(text: str) -> None:
        others = f" and {len(further)} more" if further else ""
        print(f"{record.source}{others}: {text}", file=sys.stderr, flush=True)

    folder = options.report
    path = options.out if options.out is not None else folder / MODEL if folder is not None else None
    model = None if path is None else str(path)
    found = told(record, asked, model, *holdout, report=folder is not None, further=further, say=say)
    if found.faults:
        raise Faults(found.faults)
    for line in found.lines:
        terminal.print(line)
    if folder is not None:
        found.write_files(folder)
    if options.out is not None:
        options.out.write_bytes(found.files[MODEL])
    if path is not None:
        terminal.print(f"model: {path}")
    if folder is not None:
        terminal.print(f"report: {folder / 'report.html'}")
    return found.document
