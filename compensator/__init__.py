"""Hysteresis model, its inverse, identification, plate and control law: arrays and frozen dataclasses in and out.

No clock, no port, no file and no log is known here; time is a parameter.
"""

import os
from collections.abc import Callable

report: Callable[[str], None] = lambda text: None  # noqa: E731 - to be replaced by whoever shows lines to a user
"""Called with a line when loops are compiled, and when they cannot be kept."""

os.environ.pop("NUMBA_DISABLE_JIT", None)  # meant for a user's own loops: ours need what only compiled code has
