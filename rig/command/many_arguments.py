"""Arguments that every verb shares that has many cases: where they are computed."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.many.engine import EngineChoice


def add_engine_arguments(parser: argparse.ArgumentParser) -> None:
    """--workers, --engine, --address."""
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: one a core")
    parser.add_argument(
        "--engine", default="processes", metavar="NAME", help="processes (default) or dask (extra 'cluster')"
    )
    parser.add_argument(
        "--address", metavar="tcp://...", help="of a Dask scheduler; without it Dask begins a cluster on this computer"
    )


def engine_choice(options: argparse.Namespace) -> EngineChoice:
    """What was chosen. Raises Faults."""
    from rig.many.engine import EngineChoice

    return EngineChoice(options.engine, options.workers, options.address)
