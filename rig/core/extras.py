"""What to type for packages that a part of the program needs, and that are not installed."""

from __future__ import annotations

import shlex
import sys
from typing import Final

PACKAGES: Final = {  # the extras of pyproject.toml
    "visa": ("pyvisa>=1.14", "pyvisa-py>=0.7.2"),
    "files": ("openpyxl>=3.1",),
    "epics": ("softioc>=4.7",),
    "cluster": ("distributed>=2025.1",),
}


def to_install(extra: str) -> str:
    """The command that installs them for the Python that runs this program, whether from a checkout or not."""
    return shlex.join([sys.executable, "-m", "pip", "install", *PACKAGES[extra]])
