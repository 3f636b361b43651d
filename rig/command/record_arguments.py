"""Arguments that every verb shares that reads records."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.faults import fault


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
        raise fault("--limits", repr(text), "expected LOW,HIGH in degC, as in -50,200") from None
    if not low < high:
        raise fault("--limits", repr(text), "expected LOW < HIGH")
    return low, high


def writable_parent(path: Path) -> None:
    """Refuse an output file whose folder is not there. Raises Faults."""
    if not path.resolve().parent.is_dir():
        raise fault(path, "", f"its folder {path.resolve().parent} does not exist")
