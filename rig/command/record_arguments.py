"""Arguments that every verb shares that reads records."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from rig.faults import fault
from rig.files.toml_text import shown


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    """--column OURS=THEIRS[@UNIT], repeatable."""
    parser.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="OURS=THEIRS[@UNIT]",
        help="a column of a record from elsewhere, as in temperature_degC=T_K@K or resistance_ohm=R@kohm",
    )


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", metavar="FILE", help="write the results as JSON; - is stdout")


def parsed_limits(text: str) -> tuple[float, float]:
    """LOW,HIGH in degC. Raises Faults."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise fault("--limits", shown(text), "expected LOW,HIGH in degC, as in -50,200") from None
    if not -273.15 <= low < high <= 1e6:
        raise fault("--limits", repr(text), "expected LOW < HIGH, degC")
    return low, high


def writable_parent(path: Path) -> None:
    """Refuse an output that cannot be written, before anything is computed. Raises Faults."""
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


def writable_file(path: Path) -> None:
    """The same for a file, which no folder may stand in the way of."""
    writable_parent(path)
    if path.is_dir():
        raise fault(path, "", "is a folder; expected a file")
