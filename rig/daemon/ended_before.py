"""What the guard wrote of a job that was running when the daemon's process died: whether its "off" can be believed.

Import-light.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

from rig.guard.left_behind import DIED

OFF_CONTRADICTED = "off_contradicted"  # the trip of a temperature that goes on as if the output were on


LOOK_AGAIN_S = 0.2  # for what the guard writes


def not_confirmed_off(folder: str | None) -> str | None:
    """Why the output of a job is not confirmed off, in words; None where it is, or where nobody says.

    folder: the job's, with the runs inside it.
    """
    return next((text for confirmed, text in _ends(folder) if not confirmed), None)


def found_by_the_guard(folder: str, within_s: float) -> tuple[bool, str] | None:
    """Whether the output is off, confirmed, and what the guard wrote of that; None where it writes nothing in time."""
    until_s = time.monotonic() + within_s
    while (end := next(_ends(folder), None)) is None and time.monotonic() < until_s:
        time.sleep(LOOK_AGAIN_S)
    return end


def _ends(folder: str | None) -> Iterator[tuple[bool, str]]:
    """(output off confirmed, text) of each run in a folder whose end the guard wrote."""
    for path in sorted(Path(folder).rglob("run.json")) if folder is not None else ():
        try:
            stop = json.loads(path.read_text(encoding="utf-8")).get("stop", {})
            if stop["reason"] == DIED:
                yield bool(stop["output_off_confirmed"]), str(stop["text"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):  # no end, or none that the guard wrote
            continue
