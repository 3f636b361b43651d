"""The whole runs below a folder, in the order of their times."""

from __future__ import annotations

import datetime
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core.faults import fault

FORMAT = "peltier-run/1"


@dataclass(frozen=True)
class RunInFolder:
    """A run. at: when it began, UTC; rig: its controller, with the serial number where it has one."""

    folder: Path
    at: datetime.datetime
    rig: str

    @property
    def record(self) -> Path:
        """Its rows."""
        return self.folder / "record.csv"


def runs_in(folder: Path) -> list[RunInFolder]:
    """The runs that have come to their end; those that a run has inside it (its calibration) too. Raises Faults."""
    if not folder.is_dir():
        raise fault(folder, "", "no such folder; expected one with run folders in it")
    found = []
    for path in sorted(folder.rglob("run.json")):
        run = _run(path)
        if run is not None and not any(part.endswith(".part") for part in path.parts):
            found.append(run)
    if not found:
        raise fault(folder, "", "no run folder in it that came to its end; expected some with run.json and record.csv")
    return sorted(found, key=lambda run: (run.at, str(run.folder)))


def _run(path: Path) -> RunInFolder | None:
    try:
        document: Any = json.loads(path.read_bytes())
        start = document["start"]
        at = datetime.datetime.fromisoformat(start["at"])
        if document["format"] != FORMAT or document["stop"]["reason"] != "done":
            return None
        controller = dict(start["instruments"]["controller"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    if at.tzinfo is None:
        at = at.replace(tzinfo=datetime.UTC)
    words = [str(controller.get(key) or "") for key in ("maker", "model", "serial_number")]
    return RunInFolder(path.parent, at.astimezone(datetime.UTC), " ".join(word for word in words if word))
