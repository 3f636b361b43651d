"""What the guard wrote of a job that was running when the daemon's process died: whether its "off" can be believed."""

from __future__ import annotations

import json
from pathlib import Path

from rig.guard.left_behind import DIED

OFF_CONTRADICTED = "off_contradicted"  # the trip of a temperature that goes on as if the output were on


def not_confirmed_off(folder: str | None) -> str | None:
    """Why the output of a job is not confirmed off, in words; None where it is, or where nobody says.

    folder: the job's, with the runs inside it.
    """
    if folder is None:
        return None
    for path in sorted(Path(folder).rglob("run.json")):
        try:
            stop = json.loads(path.read_text(encoding="utf-8")).get("stop", {})
            if stop["reason"] == DIED and not stop["output_off_confirmed"]:
                return str(stop["text"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):  # no end, or none that the guard wrote
            continue
    return None
