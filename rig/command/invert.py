"""peltier invert MODEL.toml TARGET.csv [--out F]: temperatures for a desired resistance (time_s, target_ohm).

For a model of another output, such as curvature_per_m, the target is in target_curvature_per_m, and the columns written
are curvature_per_m and nearest_curvature_per_m instead of those in ohm.

Of several temperatures the nearest to the row before is taken, in the first row the lowest. Where a target cannot be
reached within the limits, temperature and memory stay, `reachable` is 0, and `nearest_ohm` is what could be.
"""

from __future__ import annotations

import argparse
import math
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
from rig.command.say import Voice
from rig.control.law_units import plain_units
from rig.core.faults import Faults, fault
from rig.files.film_output import column_of, in_decades, sign_of
from rig.files.record_file import print_columns, write_columns


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml")
    parser.add_argument("target", type=Path, metavar="TARGET.csv", help="columns time_s, target_ohm")
    add_record_arguments(parser)
    parser.add_argument("--out", type=Path, metavar="F", help="default: stdout")
    parser.add_argument("--limits", default="-50,200", metavar="LOW,HIGH", help="degC (-50,200)")
    parser.add_argument("--initial", choices=["cooled", "heated"], help="default: the model's own")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from compensator.inverse.inverse import Inverse
    from rig.files.model_file import read_model

    if options.out is not None:
        writable_file(options.out)
    low, high = parsed_limits(options.limits)
    voice = Voice("-" if options.out is None else options.json)
    film = read_model(options.model, needs=("film",)).film
    assert film is not None
    decades, name = in_decades(film.output), column_of(film.output)
    wanted = "target_ohm" if name == "resistance_ohm" else f"target_{name}"
    (record,) = read_records([options.target], options, needs=(wanted,) if wanted == "target_ohm" else ())
    if wanted not in record.columns:
        raise fault(options.target, wanted, f"missing; there are {', '.join(record.columns)}")
    target = record[wanted]
    expected = "a finite number > 0" if decades else "a finite number"
    bad = [
        f"{options.target}: row {k + 1}: {wanted}: {float(target[k])!r}: expected {expected}"
        for k in np.flatnonzero(~(np.isfinite(target) & ((target > 0.0) | (not decades))))[:10]
    ]
    if bad:
        raise Faults(bad)
    violating = int(np.sum((film.order_margin(low, high) < -1e-12) & (film.weights > 0.0)))
    if violating:
        print(
            f"{options.model}: film.radii: {violating} operators violate the order condition: the output jumps at "
            "reversals, and targets inside a jump are reported as not reachable",
            file=sys.stderr,
        )
    columns, counts = inverted(
        Inverse(film, low, high), sign_of(film.output) * (np.log10(target) if decades else target), options.initial
    )
    table: dict[str, Any] = {**record.columns, **record.text_columns, **columns}
    if options.out is not None:
        write_columns(options.out, table)
    else:
        print_columns(sys.stdout, table)
    reached = int(np.sum(columns["reachable"]))
    voice.say(f"{reached} of {target.size} targets reachable, {np.mean(counts):.2f} evaluations a row")
    if options.json is not None:
        Voice(options.json).report(
            {
                "format": "peltier-inversion/1",
                "rows": int(target.size),
                "reachable": reached,
                "evaluations_mean": float(np.mean(counts)),
                "evaluations_max": int(np.max(counts)),
            }
        )
    return 0


def inverted(inverse: Any, wanted: np.ndarray, initial: str | None) -> tuple[dict[str, Any], list[int]]:
    """The four columns of `invert`, and the evaluations that each row took."""
    film, units = inverse.model, plain_units(inverse.model)
    rows: list[tuple[float, int, float, float]] = []
    counts, memory = [], None
    for target in wanted:
        solution = inverse.first(float(target), initial) if memory is None else inverse.solve(float(target), memory)
        counts.append(solution.evaluations)
        if solution.reachable:
            memory = solution.memory
        output = film.output_at(memory) if memory is not None else math.nan
        temperature = memory.input_degC if memory is not None else math.nan
        shown = units.shown(output)
        nearest = shown if solution.reachable else units.shown(solution.nearest)
        rows.append((temperature, int(solution.reachable), shown, nearest))
    name = column_of(film.output)
    last = "nearest_ohm" if name == "resistance_ohm" else f"nearest_{name}"
    return {
        "temperature_degC": np.array([row[0] for row in rows]),
        "reachable": np.array([row[1] for row in rows]),
        name: np.array([row[2] for row in rows]),
        last: np.array([row[3] for row in rows]),
    }, counts
