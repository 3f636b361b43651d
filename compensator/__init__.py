"""Hysteresis model, its inverse, identification, plate and control law: arrays and frozen dataclasses in and out.

No clock, no port and no file is known here; time is a parameter.
"""

from __future__ import annotations

import os

TYPE_CHECKING = False  # `peltier off` comes through here, and `typing` takes longer than all else that it imports
if TYPE_CHECKING:
    from collections.abc import Callable

listeners: list[Callable[[str], None]] = []
"""The last one is called with a line when loops are compiled, and when they cannot be kept."""

os.environ.pop("NUMBA_DISABLE_JIT", None)  # meant for a user's own loops: ours need what only compiled code has
