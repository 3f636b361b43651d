"""Whether a configuration's ports are real, so that a guard is needed: read without the schema, which is large."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rig.faults import Faults
from rig.files.toml_text import read_toml
from rig.guard.line import UNGUARDED, Guard
from rig.guard.process import guarded


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
