"""Arguments that every verb shares that reads records."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rig.config.toml_file import shown
from rig.core.faults import Faults, fault
from rig.records.film_output import FALLING_RESISTANCE

if TYPE_CHECKING:
    from rig.records.branches import RowOrder
    from rig.records.record import Record, Refused

MOST_NAMED = 3  # files, in a line that is about all of them


def add_record_arguments(parser: argparse._ActionsContainer) -> None:
    """Add --column, --decimal, and what a file without times does not say: --period, --reversed, --branches."""
    parser.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="OURS=THEIRS[|OTHER...][@UNIT]",
        help="which column of a file is OURS: as in temperature_degC=T_K@K or resistance_ohm=R@kohm; of several "
        "names the first that a file has; #3 is its third column",
    )
    parser.add_argument(
        "--decimal", choices=[".", ","], default="", help="the decimal sign, if the file does not show which it is"
    )
    parser.add_argument("--period", type=float, metavar="SECONDS", help="time between rows of a record without times")
    parser.add_argument("--reversed", action="store_true", help="the last row of a record was taken first")
    parser.add_argument(
        "--branches", action="store_true", help="heating and cooling are in two files, or side by side in one"
    )


def rows_of(options: argparse.Namespace) -> RowOrder:
    """Return the order of the rows that was typed. Raises Faults."""
    from rig.records.branches import RowOrder

    if options.period is not None and not 0.0 < options.period < math.inf:
        raise fault("--period", f"{options.period:g}", "expected a number of seconds > 0")
    return RowOrder(options.period, options.reversed, options.branches)


def read_records(
    paths: Sequence[Path], options: argparse.Namespace, needs: Iterable[str] = ("temperature_degC",)
) -> list[Record]:
    """Read the records of a verb by its arguments, and print how columns were read on stderr. Raises the Faults of
    all."""
    from rig.records.record import Record, Refused

    found = read_each(paths, options, needs)
    if refused := [one for one in found if isinstance(one, Refused)]:
        raise Faults(_faults_of(refused))
    return [one for one in found if isinstance(one, Record)]


def read_each(
    paths: Sequence[Path], options: argparse.Namespace, needs: Iterable[str] = ("temperature_degC",)
) -> list[Record | Refused]:
    """Read records for a verb that goes on without those that are refused, in the order of the paths. Raises Faults if
    none is left."""
    from rig.records.branches import join_branches
    from rig.records.record import Record, Refused
    from rig.records.record_file import ColumnMapping, read_record

    mappings, rows = [ColumnMapping.parse(text) for text in options.column], rows_of(options)
    found: list[Record | Refused] = []
    for path in paths:
        try:
            found.append(read_record(path, mappings, needs, options.decimal, order=rows))
        except Faults as faults:
            found.append(Refused(str(path), tuple(faults.lines)))
    found = join_branches(found, rows)
    said: dict[str, list[str]] = {}  # of hundreds of records of one make the same is said of all: once is enough
    for one in found:
        for line in one.notes if isinstance(one, Record) else ():
            said.setdefault(line, []).append(one.source)
    for line, sources in said.items():
        more = f" and {len(sources) - 1} more" if len(sources) > 1 else ""
        print(f"{sources[0]}{more}: {line}", file=sys.stderr)
    refused = [one for one in found if isinstance(one, Refused)]
    if len(refused) == len(found):
        raise Faults(_faults_of(refused))
    return found


def _faults_of(refused: Iterable[Refused]) -> list[str]:
    """Return the lines of files that were refused; one about names that several files have is one line."""
    sources: dict[str, list[str]] = {}
    for one in refused:
        for line in one.faults:
            text = line.removeprefix(one.source)
            sources.setdefault(text if "--column" in text else line, []).append(one.source)
    lines = []
    for text, of in sources.items():
        more = f" and {len(of) - MOST_NAMED} more" if len(of) > MOST_NAMED else ""
        lines.append(f"{', '.join(of[:MOST_NAMED])}{more}{text}" if "--column" in text else text)
    return lines


def add_effect_file_argument(parser: argparse._ActionsContainer, which: str = "") -> None:
    """Add --effect-file, repeatable. which: of what a user-defined effect is."""
    parser.add_argument(
        "--effect-file",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help=f"a Python file with a user-defined effect{which} (repeatable)",
    )


def add_json_argument(parser: argparse._ActionsContainer) -> None:
    """Add --json."""
    parser.add_argument("--json", type=_json_target, metavar="FILE", help="write the results as JSON; - is stdout")


def _json_target(text: str) -> str:
    return text if text == "-" else str(writable_file(text))


def add_output_argument(parser: argparse._ActionsContainer) -> None:
    """Add --output."""
    parser.add_argument(
        "--output",
        default=FALLING_RESISTANCE,
        metavar="COLUMN",
        help="the film's output where it is not a resistance on a log scale: a column with its unit, as "
        "curvature_per_m or resistance_ohm",
    )


def parsed_limits(text: str) -> tuple[float, float]:
    """Return (low, high) in degC of a text LOW,HIGH. Raises Faults."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise fault("--limits", shown(text), "expected LOW,HIGH in degC, as in -50,200") from None
    if not -273.15 <= low < high <= 1e6:
        raise fault("--limits", repr(text), "expected LOW < HIGH, degC")
    return low, high


def _writable(path: Path) -> Path:
    """Return the path of an output. Raises Faults if it cannot be written, before anything is computed."""
    try:
        folder = path.resolve().parent
        there = folder.is_dir()
        path.exists()  # whether a name is too long
    except (OSError, RuntimeError) as error:  # RuntimeError: links that lead in a circle
        raise fault(shown(str(path)), "", f"cannot be written: {getattr(error, 'strerror', None) or error}") from None
    if not there:
        raise fault(path, "", f"its folder {folder} does not exist")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise fault(path, "", "cannot be written: permission denied")
    return path


def writable_file(text: str) -> Path:
    """Return the path of a file to write, as the type of an argument. Raises Faults if it cannot be written."""
    path = _writable(Path(text))
    if path.is_dir():
        raise fault(path, "", "is a folder; expected a file")
    return path


def writable_folder(text: str) -> Path:
    """Return the path of a folder to write, which may exist, as the type of an argument. Raises Faults if it cannot be
    written."""
    path = _writable(Path(text))
    if path.exists() and not path.is_dir():
        raise fault(path, "", "is a file; expected a folder")
    return path
