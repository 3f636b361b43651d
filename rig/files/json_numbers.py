"""Numbers that JSON does not know, as the daemon's answers and the page have them. Import-light.

What is written to files keeps the sign of an infinity, as text (`rig.files.run_folder.plain_json`): it says that an
instrument was beyond its range, and at which end. Who reads an answer wants a number or none.
"""

from __future__ import annotations

import math
from typing import Any


def finite(value: Any) -> Any:
    """The value with null for what is no finite number, however deep inside it."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    return [finite(entry) for entry in value] if isinstance(value, (list, tuple)) else value
