"""Hysteresis model, its inverse, identification, plate and control law: arrays and frozen dataclasses in and out.

No clock, no port and no file is known here; time is a parameter.
"""

import os
from collections.abc import Callable

listeners: list[Callable[[str], None]] = []
"""The last one is called with a line when loops are compiled, and when they cannot be kept."""

os.environ.pop("NUMBA_DISABLE_JIT", None)  # meant for a user's own loops: ours need what only compiled code has
