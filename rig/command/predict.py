"""peltier predict MODEL.toml RECORD... [--out F]: compare a model with records that it was not fitted to, one by one.

The film is simulated from the measured temperature; with current_A and a [plate] the temperature is simulated from the
current over the whole record. With --drive current (default if the model says so or has [[effects]]) the film follows
the simulated plate. With --initial fitted room, first temperatures and film memory are fitted to the first rows of the
record, which then do not count.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.command.record_arguments import (
    add_effect_file_argument,
    add_json_argument,
    add_record_arguments,
    read_records,
    writable_file,
    writable_folder,
)
from rig.command.terminal import Terminal
from rig.core.faults import fault
from rig.records.record_file import Record, write_columns

if TYPE_CHECKING:
    from rig.config.model_file import Model


def arguments(parser: argparse.ArgumentParser) -> None:
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
    parser.add_argument("--out", type=Path, metavar="F", help="the record's columns with the predictions, CSV")
    parser.add_argument("--report", type=Path, metavar="DIR", help="report.html, figures and prediction.json there")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.config.model_file import read_model

    if options.out is not None:
        writable_file(options.out)
    if options.report is not None:
        writable_folder(options.report)
    terminal = Terminal(options.json)
    if options.effect_file:
        from rig.config.effect_tables import add_effect_files

        add_effect_files(options.effect_file)
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
