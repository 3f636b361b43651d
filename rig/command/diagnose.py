"""peltier diagnose RECORD...: where the simulated rig and the real one part, why, and what the repair gains.

The base model is fitted to the record, then every effect of the catalogue with it; those are named that the record
needs, and what they gain is measured on rows that no fit has seen. What is left over is called unexplained. A record
without resistance is diagnosed as far as the plate goes, one without current as far as the film goes.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.command.record_arguments import (
    add_json_argument,
    add_record_arguments,
    read_records,
    writable_file,
    writable_parent,
)
from rig.command.say import Voice
from rig.core.faults import Faults, fault
from rig.files.record_file import Record

if TYPE_CHECKING:
    from rig.files.model_file import Model
    from sim.diagnosis.result import Diagnosis


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    add_record_arguments(parser)
    parser.add_argument("--model", type=Path, metavar="MODEL.toml", help="a film without D(T) in it restricts the base")
    parser.add_argument(
        "--base",
        choices=["extended_generalized_pi", "generalized_pi"],
        help="the film's base model; generalized_pi: without D(T)",
    )
    parser.add_argument("--plate", choices=["peltier", "heater"], help="kind of plate; default: what the drive allows")
    parser.add_argument("--holdout", type=Path, metavar="RECORD", help="measure the gain on this record of the rig")
    parser.add_argument(
        "--initial",
        choices=["cooled", "heated", "fitted"],
        default="fitted",
        help="the film's memory at the first row is always fitted with the record",
    )
    parser.add_argument(
        "--effect-file",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="a Python file with an effect of one's own (repeatable)",
    )
    parser.add_argument("--report", type=Path, metavar="DIR", help="report.html, diagnosis.json and model.toml there")
    parser.add_argument("--out", type=Path, metavar="MODEL.toml", help="the extended model")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    several = len(options.records) > 1
    if options.out is not None:
        if several:
            raise fault("--out", str(options.out), "expected a single RECORD; --report DIR writes a model for each")
        writable_file(options.out)
    if options.report is not None:
        writable_parent(options.report)
    voice = Voice(options.json)
    if options.effect_file:
        from rig.files.effect_tables import add_effect_files

        add_effect_files(options.effect_file)
    base = _base(options)
    if options.initial != "fitted":
        print("--initial: the film's memory is fitted with the record", file=sys.stderr)
    records = read_records(options.records, options)
    holdout = read_records([options.holdout], options)[0] if options.holdout is not None else None
    from rig.analysis.diagnosed import diagnosed

    documents: list[dict[str, Any]] = []
    faults: list[str] = []
    for path, record in zip(options.records, records, strict=True):
        try:
            say = partial(_say, record.source)
            diagnosis, model = diagnosed(record, base, holdout, options.plate, say)
        except Faults as found:
            faults += found.lines
            continue
        folder = options.report / path.stem if options.report is not None and several else options.report
        documents.append(_told(diagnosis, model, record, folder, options.out, voice, several))
    if faults and documents:
        for line in faults:
            print(line, file=sys.stderr)
    elif faults:
        raise Faults(faults)
    voice.report(documents if several else documents[0])
    return 0


def _say(source: str, text: str) -> None:
    print(f"{source}: {text}", file=sys.stderr, flush=True)


def _base(options: argparse.Namespace) -> str | None:
    """The base that was asked for, or that the model has."""
    if options.base is not None:
        return str(options.base)
    if options.model is None:
        return None
    from rig.files.model_file import read_model

    film = read_model(options.model).film
    if film is None or film.memoryless.function != "none":
        return None
    print(f"{options.model}: its film has no D(T): base generalized_pi", file=sys.stderr)
    return "generalized_pi"


def _told(
    diagnosis: Diagnosis,
    model: Model,
    record: Record,
    folder: Path | None,
    out: Path | None,
    voice: Voice,
    several: bool,
) -> dict[str, Any]:
    """Files and lines; returns the JSON."""
    from rig.files.model_file import write_model
    from rig.report.diagnosis_words import lines
    from sim.diagnosis.result import with_model

    if several:
        voice.say(f"{record.source}:")
    for line in lines(diagnosis):
        voice.say(line)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    paths = [path for path in (out, folder / "model.toml" if folder is not None else None) if path is not None]
    for path in paths:
        write_model(path, model, f"extended model of the diagnosis of {Path(record.source).name}")
    if paths:
        diagnosis = with_model(diagnosis, str(paths[0]))
        voice.say(f"model: {paths[0]}")
    if folder is not None:
        from rig.report.diagnosis import write_diagnosis_report

        write_diagnosis_report(folder, diagnosis, record.source)
        voice.say(f"report: {folder / 'report.html'}")
    return diagnosis.document()
