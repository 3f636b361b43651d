"""Decide whether a run needs a guard, and refuse real ports that neither a guard nor a dead man protects.

If the program hangs, its guard switches the output off, or the controller's own dead man. Without either, nothing runs
on real ports unless the user gives --unguarded. The ports are read without the schema, which takes long to load.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rig.config.toml_file import read_toml
from rig.core.faults import Faults, fault
from rig.guard.pipe import UNGUARDED, Guard
from rig.guard.process import guarded

if TYPE_CHECKING:
    from rig.config.configuration import ConfigurationFile


def has_real_ports(configuration: Path) -> bool:
    """Return True for real ports; False for sim:// and for a file that cannot be read, which is reported later."""
    try:
        port = read_toml(configuration)["bench"]["controller"]["port"]
    except (Faults, KeyError, TypeError):
        return False
    return isinstance(port, str) and not port.startswith("sim://")


def guarded_where_needed(configuration: Path, own_process: bool, work: Callable[[Guard], int]) -> int:
    """Do `work` under a guard if the ports are real and this process may fork; return as `guarded` does."""
    if own_process and has_real_ports(configuration):
        return guarded(work)
    return work(UNGUARDED)


def add_unguarded_argument(parser: argparse.ArgumentParser) -> None:
    """Add --unguarded, for the verbs that arm the output."""
    parser.add_argument(
        "--unguarded",
        action="store_true",
        help="run although neither a guard process nor the controller's own dead man would switch the output off",
    )


def require_who_switches_off(file: ConfigurationFile, guard: Guard, unguarded: bool) -> None:
    """Raise Faults for real ports without a guard process (a system without fork) and without a dead man."""
    from rig.drivers.registry import controller_class

    table = file.content.bench.controller
    if guard.guarding or unguarded or table.port.startswith("sim://"):
        return
    try:
        driver = controller_class(table.driver)
    except ValueError:  # reported when the port is opened
        return
    if not driver.has_dead_man:
        raise fault(
            file.path,
            "bench.controller.driver",
            f"{table.driver!r} has no dead man of its own, and this system has no guard process: if the program hangs, "
            "the output stays on; expected another controller, or --unguarded",
        )
