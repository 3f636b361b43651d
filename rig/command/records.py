"""Verbs of records and models: identify, predict, invert, diagnose."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.batch import is_of_many
from rig.command.many import add_engine_arguments, report_each
from rig.command.record_arguments import (
    add_effect_file_argument,
    add_json_argument,
    add_output_argument,
    add_record_arguments,
    parsed_limits,
    read_each,
    read_records,
    writable_file,
    writable_folder,
)
from rig.command.terminal import Terminal, to_stderr
from rig.core.faults import Faults, fault
from rig.core.file_writing import writing
from rig.core.streams import TerminalLine
from rig.records.record_file import Record, print_columns, write_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.config.model_file import Model
    from rig.report.batch import Task


def identify_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    add_record_arguments(parser)
    parser.add_argument("--out", type=writable_file, metavar="MODEL.toml")
    text = "report.html, figures, identification.json and model.toml there"
    parser.add_argument("--report", type=writable_folder, metavar="DIR", help=text)
    parser.add_argument("--each", action="store_true", help="fit a model to each record instead of one to all")
    add_engine_arguments(parser)
    add_json_argument(parser)
    parser.add_argument(
        "--kind",
        choices=["extended_generalized_pi", "generalized_pi", "mixed_envelopes"],
        help="kind of the film model; default: chosen by held-out rows",
    )
    parser.add_argument("--form", help="form of the memoryless function D(T); default: chosen by held-out rows")
    parser.add_argument("--operators", type=int, default=30, help="play operators (30)")
    parser.add_argument("--initial", choices=["cooled", "heated", "fitted"], default="fitted")
    parser.add_argument(
        "--violate-order",
        action="store_true",
        help="allow radii that break the order condition (the output then jumps)",
    )
    parser.add_argument(
        "--compress", type=int, metavar="N", help="keep at most N operators in the model, and print the loss"
    )
    add_output_argument(parser)
    parser.add_argument("--plate", choices=["peltier", "heater"], default="peltier", help="kind of the plate model")


def identify(options: argparse.Namespace) -> int:
    """peltier identify RECORD... [--out MODEL.toml]: film and plate models from records, with error bars.

    The film is fitted to records with temperature and resistance, the plate to records with temperature and current.
    With --each every record gets its own model; --report DIR then has a folder for each, and a table of all.
    """
    if options.out is not None and options.each:
        raise fault("--out", str(options.out), "expected --report DIR with --each: it has a model of each record")
    if is_of_many(options.report) and not options.each:
        expected = "has the table of many records; expected --each, or another DIR"
        raise fault("--report", str(options.report), expected)
    terminal = _checked(options)
    each = read_each(options.records, options) if options.each else []
    records = [] if options.each else read_records(options.records, options)
    from rig.analysis.identification import FitOptions  # a second or two: after what may be refused has been read
    from rig.report.model_pages import identifications

    task = identifications(FitOptions(**{field.name: getattr(options, field.name) for field in fields(FitOptions)}))
    if options.each:
        return report_each(each, task, options, terminal)
    terminal.write_json(_together(records, task, options, terminal, terminal.print))
    return 0


def predict_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml")
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    add_record_arguments(parser)
    parser.add_argument(
        "--initial",
        choices=["cooled", "heated", "fitted"],
        help="the film's memory at the first row; default: the model's. fitted: fit it, room and first temperatures",
    )
    parser.add_argument(
        "--first",
        type=float,
        metavar="SECONDS",
        help="duration of the rows that --initial fitted uses (default 30 s or 20 rows, the longer)",
    )
    parser.add_argument(
        "--drive",
        choices=["current", "temperature"],
        help="what the film follows: the simulated plate or the thermometer; default: as the model says",
    )
    add_effect_file_argument(parser, " that the model has")
    text = "the record's columns with the predictions, CSV"
    parser.add_argument("--out", type=writable_file, metavar="F", help=text)
    text = "report.html, figures and prediction.json there"
    parser.add_argument("--report", type=writable_folder, metavar="DIR", help=text)
    add_json_argument(parser)


def predict(options: argparse.Namespace) -> int:
    """peltier predict MODEL.toml RECORD... [--out F]: compare a model with other records, one by one.

    The film is simulated from the measured temperature; with current_A and a [plate] the temperature is simulated from
    the current over the whole record. With --drive current (default if the model says so or has [[effects]]) the film
    follows the simulated plate. With --initial fitted room, first temperatures and film memory are fitted to the first
    rows of the record, which then do not count.
    """
    from rig.config.model_file import read_model

    terminal = _checked(options)
    model = read_model(options.model)
    records = read_records(options.records, options)
    several = len(records) > 1
    if options.out is not None and several:
        raise fault("--out", str(options.out), "expected a single RECORD; --report DIR writes a page for each")
    from rig.analysis.prediction import require_something_to_predict  # seconds: after what may be refused

    for record in records:
        require_something_to_predict(model, record, options.model, options.drive)
    results, complete = [], True
    for record in records:
        folder = options.report
        if several:
            terminal.print(f"{record.source}:")
            folder = options.report / Path(record.source).stem if options.report is not None else None
        result, errors = _predicted(model, record, folder, options, terminal)
        results.append(result)
        complete = complete and errors > 0
    terminal.write_json(results if several else results[0])
    return 0 if complete or options.out is not None else 2


def _predicted(
    model: Model, record: Record, folder: Path | None, options: argparse.Namespace, terminal: Terminal
) -> tuple[dict[str, Any], int]:
    """Predict one record, print and write what is asked for; return the JSON and how many channels were compared."""
    from rig.analysis.prediction import compared

    how = {"initial": options.initial, "drive": options.drive, "first_s": options.first}
    found = compared(model, record, options.model, **how)
    for warning in found.warnings:
        print(warning, file=sys.stderr)
    for line in found.lines(options.first):
        terminal.print(line)
    result = found.document(options.model)
    if not found.errors:
        needed = "expected readings of the film, or temperature with current and a model with a [plate]"
        print(f"{record.source}: nothing to compare; {needed}", file=sys.stderr)
    if options.out is not None:
        write_columns(options.out, {**record.raw_columns(), **record.text_columns, **found.columns})
        terminal.print(f"predictions: {options.out}")
    if folder is not None:
        from rig.report.model_pages import write_prediction_report

        folder.mkdir(parents=True, exist_ok=True)
        write_prediction_report(folder, result, record["time_s"], record["temperature_degC"], found.errors)
        terminal.print(f"report: {folder / 'report.html'}")
    return result, len(found.errors)


def invert_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml")
    parser.add_argument("target", type=Path, metavar="TARGET.csv", help="columns time_s, target_ohm")
    add_record_arguments(parser)
    parser.add_argument("--out", type=writable_file, metavar="F", help="default: stdout")
    parser.add_argument("--limits", default="-50,200", metavar="LOW,HIGH", help="degC (-50,200)")
    parser.add_argument("--initial", choices=["cooled", "heated"], help="default: the model's own")
    add_json_argument(parser)


def invert(options: argparse.Namespace) -> int:
    """peltier invert MODEL.toml TARGET.csv [--out F]: temperatures for a desired resistance (time_s, target_ohm).

    For a model of another output, such as curvature_per_m, the target is in target_curvature_per_m, and the columns
    written are curvature_per_m and nearest_curvature_per_m instead of those in ohm.

    Of several temperatures the nearest to the row before is taken, in the first row the lowest. Where a target cannot
    be reached within the limits, temperature and memory stay, `reachable` is 0, `nearest_ohm` is what could be, and
    `nearest_degC` the temperature for that.
    """
    from rig.analysis.film_records import beyond_seen
    from rig.analysis.inversion import inverted, order_warning, target_name
    from rig.config.model_file import read_model

    limits_degC = parsed_limits(options.limits)
    terminal = Terminal("-" if options.out is None else options.json)
    model = read_model(options.model, needs=("film",))
    film = model.film
    assert film is not None
    wanted = target_name(film.output)
    (record,) = read_records([options.target], options, needs=(wanted,) if wanted == "target_ohm" else ())
    if wanted not in record.columns:
        raise fault(options.target, wanted, f"missing; there are {', '.join(record.columns)}")
    found = inverted(film, record[wanted], options.target, limits_degC, options.initial, model.mixing)
    warnings = order_warning(film, options.model, limits_degC), beyond_seen(model, found.asked_degC, options.model)
    for warning in warnings:
        if warning is not None:
            print(warning, file=sys.stderr)
    table: dict[str, Any] = {**record.columns, **record.text_columns, **found.columns()}
    if options.out is not None:
        write_columns(options.out, table)
    else:
        print_columns(sys.stdout, table)
    reached, rows, counts = int(np.sum(found.reachable)), found.reachable.size, found.evaluations
    to = "" if options.out is None else f"; temperatures: {options.out}"
    terminal.print(f"{reached} of {rows} targets reachable{to}")
    if options.json is not None:
        Terminal(options.json).write_json(
            {
                "format": "peltier-inversion/1",
                "rows": rows,
                "reachable": reached,
                "evaluations_mean": float(np.mean(counts)),
                "evaluations_max": int(np.max(counts)),
            }
        )
    return 0


BEGINS = "fitting the base"  # the first progress, after what may be refused
PASSING = ("tried", "dropped")  # progress that the next line replaces on a terminal


def diagnose_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    record = parser.add_argument_group("record")
    add_record_arguments(record)
    text = "fit several records of one rig together: one plate, one film, the same effects; a room for each"
    record.add_argument("--joint", action="store_true", help=text)
    text = "compute the errors on this other record of the rig (repeatable)"
    record.add_argument("--holdout", type=Path, metavar="RECORD", action="append", default=[], help=text)
    text = "fit room, first temperatures and memory of a held-out record to its first SECONDS (default 30)"
    record.add_argument("--first", type=float, metavar="SECONDS", help=text)
    model = parser.add_argument_group("model")
    add_output_argument(model)
    model.add_argument("--plate", choices=["peltier", "heater"], help="kind of plate; default: what the drive allows")
    text = "a known effect, with its known parameters (repeatable)"
    model.add_argument("--assume", action="append", default=[], metavar="NAME[:param=value]", help=text)
    add_effect_file_argument(model)
    text = "begin with a film that has (extended_) or has not a part without hysteresis, D(T); default: with"
    model.add_argument("--base", choices=["extended_generalized_pi", "generalized_pi"], help=text)
    model.add_argument("--model", type=Path, metavar="MODEL.toml", help="begin with D(T) if this model's film has one")
    text = "share of records without any effect in which one may be named (default 0.01)"
    model.add_argument("--false-alarm", type=float, metavar="SHARE", help=text)
    output = parser.add_argument_group("output")
    text = "report.html, diagnosis.json and model.toml there"
    output.add_argument("--report", type=writable_folder, metavar="DIR", help=text)
    output.add_argument("--out", type=writable_file, metavar="MODEL.toml", help="the extended model")
    add_json_argument(output)
    speed = parser.add_argument_group("speed")
    text = "time for a record; the best result until then is reported"
    speed.add_argument("--budget", type=float, metavar="SECONDS", help=text)
    add_engine_arguments(speed)


def diagnose(options: argparse.Namespace) -> int:
    """peltier diagnose RECORD...: find the effects that the simulation of the rig lacks, and their sizes.

    The base model (plate and film) is fitted to the record, then effects of the catalogue with it. Those that the
    record needs are named, with the errors in held-out rows with and without them. A residual that no effect explains
    is called unexplained. Without resistance only driver, plate and thermometer are diagnosed; without current, film
    and ohmmeter.

    Several records are diagnosed one by one. --report DIR then has a folder for each, and tables of all: report.html,
    diagnoses.csv and diagnoses.nc. After an interruption the same command continues with the missing records. With
    --joint records of one rig are fitted together: only room, first temperatures and film memory are fitted for each
    record.

    Example: peltier diagnose log.csv --column temperature_degC=T_K@K --column current_A=out@pwm255 --report diagnosis
    """
    of_many = is_of_many(options.report)
    if of_many and options.joint:
        raise fault("--report", str(options.report), "has the table of many records; expected another DIR for --joint")
    several = not options.joint and (len(options.records) > 1 or of_many)  # one more of them, as well
    if options.out is not None and several:
        expected = "expected a single RECORD, none of many; --report DIR writes a model for each"
        raise fault("--out", str(options.out), expected)
    terminal = _checked(options)
    if options.budget is not None and not options.budget > 0.0:
        raise fault("--budget", f"{options.budget:g}", "expected a number of seconds > 0")
    if options.first is not None and not options.holdout:
        raise fault("--first", f"{options.first:g}", "expected --holdout RECORD with it: nothing else is predicted")
    if options.false_alarm is not None:
        from sim.inference.evidence import FALSE_ALARMS

        if not FALSE_ALARMS[0] <= options.false_alarm <= FALSE_ALARMS[1]:
            expected = f"expected a share from {FALSE_ALARMS[0]:g} to {FALSE_ALARMS[1]:g}"
            raise fault("--false-alarm", f"{options.false_alarm:g}", expected)
    assumed = None
    if options.assume:
        from rig.config.effect_tables import parse_assumed_effects

        assumed = parse_assumed_effects(options.assume)
    base = _base(options)
    each = read_each(options.records, options) if several else []
    records = [] if several else read_records(options.records, options)
    holdout = read_records(options.holdout, options) if options.holdout else []
    from rig.analysis.diagnosed import Asked  # seconds: after what may be refused has been read
    from rig.report.diagnosis import diagnoses

    own = tuple(path.absolute() for path in options.effect_file)
    how = options.budget, options.false_alarm, options.first
    task = diagnoses(Asked(base, options.output, options.plate, assumed, *how, own), holdout)
    if several:
        return report_each(each, task, options, terminal)
    terminal.write_json(_together(records, task, options, terminal, _progress(records)))
    return 0


def _progress(records: Sequence[Record]) -> Callable[[str], None]:
    """Return what shows the progress of a diagnosis on stderr, with the time since it began."""
    began_s, line, rows = time.monotonic(), TerminalLine(sys.stderr), sum(one.rows for one in records)
    others = f" and {len(records) - 1} more" if len(records) > 1 else ""

    def say(text: str) -> None:
        shown = f"{time.monotonic() - began_s:5.0f} s  {text}"
        if text.startswith(PASSING) and sys.stderr.isatty():
            line.show(shown)
            return
        line.clear()
        if text.startswith(BEGINS):
            how_long = f"{rows:,} rows; minutes with a film, often less without (--budget SECONDS ends it)"
            to_stderr(f"{records[0].source}{others}: {how_long}")
        to_stderr(shown)

    return say


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


def _checked(options: argparse.Namespace) -> Terminal:
    """Return the terminal of a verb that reads records; load user-defined effects. Raises Faults."""
    if getattr(options, "effect_file", None):
        from rig.config.effect_tables import add_effect_files

        add_effect_files(options.effect_file)
    return Terminal(options.json)


def _together(
    records: list[Record], task: Task, options: argparse.Namespace, terminal: Terminal, say: Callable[[str], None]
) -> dict[str, Any]:
    """Do a task with one record, or with several as one: print the result, write what is asked for, return the
    document. say: takes progress. Raises Faults."""
    from rig.report.batch import MODEL

    record, *further = records
    folder = options.report
    path = options.out if options.out is not None else folder / MODEL if folder is not None else None
    model = None if path is None else str(path)
    report = folder is not None
    found = task.work(record, task.options, model, *task.shared, report=report, further=further, say=say)
    if found.faults:
        raise Faults(found.faults)
    for one in found.lines:
        terminal.print(one)
    if folder is not None:
        found.write_files(folder)
    if options.out is not None:
        with writing(options.out) as new:
            new.write_bytes(found.files[MODEL])
    if path is not None:
        terminal.print(f"model: {path}")
    if folder is not None:
        terminal.print(f"report: {folder / 'report.html'}")
    return found.document
