"""What only some systems have, and which verbs need it: they say so in a line, where it is missing. Import-light.

Linux is what is tested. Nothing but what is listed here needs more than Python and its libraries.
"""

from __future__ import annotations

import os
import socket
from importlib import import_module

from rig.core.faults import fault

NEEDS = {
    "serve": ("a guard process, Unix sockets and file locks", "`peltier run` and `peltier calibrate` work without it"),
    "epics": ("the bench daemon, which needs Unix sockets", "there is no daemon without them"),
    "emulate": ("pseudo-terminals", 'ports "sim://" simulate the same instruments inside `peltier run`'),
}
MODULES = {"serve": "fcntl", "epics": "fcntl", "emulate": "pty"}


def require(verb: str) -> None:
    """Raises Faults, a line, where this system lacks what a verb needs."""
    what, instead = NEEDS[verb]
    try:
        import_module(MODULES[verb])
        there = verb == "emulate" or (hasattr(os, "fork") and has_unix_sockets())
    except ImportError:
        there = False
    if not there:
        raise fault(f"peltier {verb}", "", f"needs {what}, which this system does not have (Linux has); {instead}")


def has_unix_sockets() -> bool:
    """Whether a daemon could listen here."""
    return hasattr(socket, "AF_UNIX")
