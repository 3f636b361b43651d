"""Requirements of a part of the program: packages of an extra, and what only some systems have. Import-light.

Linux is what is tested. Nothing but what is listed here needs more than Python and its libraries.
"""

from __future__ import annotations

import os
import shlex
import socket
import sys
from importlib import import_module
from typing import Final

from rig.core.faults import fault

PACKAGES: Final = {  # the extras of pyproject.toml
    "visa": ("pyvisa>=1.14", "pyvisa-py>=0.7.2"),
    "files": ("openpyxl>=3.1",),
    "epics": ("softioc>=4.7",),
    "cluster": ("distributed>=2025.1",),
}


def to_install(extra: str) -> str:
    """Return the command that installs the packages of an extra for the Python that runs this program."""
    return shlex.join([sys.executable, "-m", "pip", "install", *PACKAGES[extra]])


NEEDS = {
    "serve": ("a guard process, Unix sockets and file locks", "`peltier run` and `peltier calibrate` work without it"),
    "epics": ("the bench daemon, which needs Unix sockets", "there is no daemon without them"),
    "emulate": ("pseudo-terminals", 'ports "sim://" simulate the same instruments inside `peltier run`'),
}
MODULES = {"serve": "fcntl", "epics": "fcntl", "emulate": "pty"}


def require(verb: str) -> None:
    """Raise Faults if this system lacks what a verb needs."""
    what, instead = NEEDS[verb]
    try:
        import_module(MODULES[verb])
        there = verb == "emulate" or (hasattr(os, "fork") and has_unix_sockets())
    except ImportError:
        there = False
    if not there:
        raise fault(f"peltier {verb}", "", f"needs {what}, which this system does not have (Linux has); {instead}")


def has_unix_sockets() -> bool:
    return hasattr(socket, "AF_UNIX")
