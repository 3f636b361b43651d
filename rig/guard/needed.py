"""Whether a configuration's ports are real, so that a guard is needed: read without the schema, which is large.

And who switches the output off when the program hangs: its guard, or the controller's own dead man. Where there is
neither, nothing runs on real ports, unless the user says that it may.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rig.config.toml_file import read_toml
from rig.core.faults import Faults, fault
from rig.guard.line import UNGUARDED, Guard
from rig.guard.process import guarded

if TYPE_CHECKING:
    from rig.config.configuration import ConfigurationFile


def has_real_ports(configuration: Path) -> bool:
    """False for sim:// ports, and for a file that does not say: whoever reads it in earnest tells what is wrong."""
    try:
        port = read_toml(configuration)["bench"]["controller"]["port"]
    except (Faults, KeyError, TypeError):
        return False
    return isinstance(port, str) and not port.startswith("sim://")


def guarded_where_needed(configuration: Path, own_process: bool, work: Callable[[Guard], int]) -> int:
    """`work` under a guard where the ports are real and this process may fork; returns as `guarded` does."""
    if own_process and has_real_ports(configuration):
        return guarded(work)
    return work(UNGUARDED)


def add_unguarded_argument(parser: argparse.ArgumentParser) -> None:
    """--unguarded, of the verbs that arm the output."""
    parser.add_argument(
        "--unguarded",
        action="store_true",
        help="run where neither a guard process nor the controller's own dead man switches the output off",
    )


def require_who_switches_off(file: ConfigurationFile, guard: Guard, unguarded: bool) -> None:
    """Raises Faults for real ports without a guard process (a system without fork) and without a dead man."""
    from rig.drivers.registry import controller_class

    table = file.content.bench.controller
    if guard.guarding or unguarded or table.port.startswith("sim://"):
        return
    try:
        driver = controller_class(table.driver)
    except ValueError:  # told where the port is opened
        return
    if not driver.has_dead_man:
        raise fault(
            file.path,
            "bench.controller.driver",
            f"{table.driver!r} has no dead man of its own, and there is no guard process here: nobody switches the "
            "output off when the program hangs; expected another controller, or --unguarded",
        )
