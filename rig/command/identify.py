"""peltier identify RECORD... [--out MODEL.toml]: film and plate models from records, with error bars.

The film is fitted to records with temperature and resistance, the plate to records with temperature and current.
With --each every record gets its own model; --report DIR then has a folder for each, and a table of all.
"""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path

from rig.batch import is_of_many
from rig.command.batch import add_engine_arguments, report_each
from rig.command.record_arguments import (
    add_json_argument,
    add_output_argument,
    add_record_arguments,
    read_each,
    read_records,
    writable_file,
    writable_folder,
)
from rig.command.terminal import Terminal
from rig.core.faults import fault


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    add_record_arguments(parser)
    parser.add_argument("--out", type=Path, metavar="MODEL.toml")
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="report.html, figures, identification.json and model.toml there"
    )
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
    parser.add_argument("--seed", type=int, default=0)


def main(options: argparse.Namespace) -> int:
    if options.out is not None:
        if options.each:
            raise fault("--out", str(options.out), "expected --report DIR with --each: it has a model of each record")
        writable_file(options.out)
    if options.report is not None:
        writable_folder(options.report)
        if is_of_many(options.report) and not options.each:
            expected = "has the table of many records; expected --each, or another DIR"
            raise fault("--report", str(options.report), expected)
    terminal = Terminal(options.json)
    each = read_each(options.records, options) if options.each else []
    records = [] if options.each else read_records(options.records, options)
    from rig.analysis.identification import FitOptions  # a second or two: after what may be refused has been read
    from rig.report.model_pages import report_identification

    fit = FitOptions(**{field.name: getattr(options, field.name) for field in fields(FitOptions)})
    if options.each:
        from rig.report.model_pages import identifications

        return report_each(each, identifications(fit), options, terminal)
    folder = options.report
    if folder is not None:
        folder.mkdir(exist_ok=True)
    models = [path for path in (options.out, folder / "model.toml" if folder is not None else None) if path is not None]
    result = report_identification(records, fit, models, folder, terminal.print)
    if models:
        terminal.print(f"model: {models[0]}")
    if folder is not None:
        terminal.print(f"report: {folder / 'report.html'}")
    terminal.write_json(result)
    return 0
