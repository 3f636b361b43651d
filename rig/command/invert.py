"""peltier invert MODEL.toml TARGET.csv [--out F]: temperatures for a desired resistance (time_s, target_ohm).

For a model of another output, such as curvature_per_m, the target is in target_curvature_per_m, and the columns written
are curvature_per_m and nearest_curvature_per_m instead of those in ohm.

Of several temperatures the nearest to the row before is taken, in the first row the lowest. Where a target cannot be
reached within the limits, temperature and memory stay, `reachable` is 0, `nearest_ohm` is what could be, and
`nearest_degC` the temperature for that.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from rig.command.record_arguments import (
    add_json_argument,
    add_record_arguments,
    parsed_limits,
    read_records,
    writable_file,
)
from rig.command.terminal import Terminal
from rig.core.faults import fault
from rig.records.record_file import print_columns, write_columns


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml")
    parser.add_argument("target", type=Path, metavar="TARGET.csv", help="columns time_s, target_ohm")
    add_record_arguments(parser)
    parser.add_argument("--out", type=Path, metavar="F", help="default: stdout")
    parser.add_argument("--limits", default="-50,200", metavar="LOW,HIGH", help="degC (-50,200)")
    parser.add_argument("--initial", choices=["cooled", "heated"], help="default: the model's own")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.analysis.film_records import beyond_seen
    from rig.analysis.inversion import inverted, order_warning, target_name
    from rig.config.model_file import read_model

    if options.out is not None:
        writable_file(options.out)
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
    terminal.print(f"{reached} of {rows} targets reachable, {np.mean(counts):.2f} evaluations a row")
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
