"""The runs of a folder diagnosed, each once: what is known of a run is kept, under the digest of its record."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rig.core.faults import Faults
from rig.many.cases import Case
from rig.many.computed import compute_missing
from rig.many.engine import Engine, EngineChoice
from rig.many.journal import Journal
from rig.records.record_file import read_record
from rig.records.run_folder import FinishedRun
from rig.rehearsal.swept import in_a_line, of_record

Row = dict[str, Any]
DIGITS = 12  # of a digest in hexadecimal: 48 bits, which a double holds exactly


def diagnose_runs(
    runs: Sequence[FinishedRun],
    folder: Path,
    out: Path,
    choice: EngineChoice,
    tell: Callable[[int, int, Row], None],
) -> list[Row]:
    """A row a run, in the order of their times: run, at, rig, and what the diagnosis says. Raises Faults."""
    numbered: dict[int, FinishedRun] = {}
    for run in runs:
        number = int(hashlib.sha256(run.record.read_bytes() + run.at.isoformat().encode()).hexdigest()[:DIGITS], 16)
        numbered.setdefault(number, run)
    identities = {number: _identity(number, run, folder) for number, run in numbered.items()}
    journal = Journal(out, "trend", identities, same=("number", "run", "at", "rig"))

    def cases(engine: Engine, left: list[int]) -> Iterator[Case]:
        for number in left:
            try:
                record = read_record(numbered[number].record)
            except Faults as faults:
                journal.add(number, {"status": "failed", "text": in_a_line(faults)}, 0.0)
                continue
            yield Case(number, of_record, ("diagnosis", engine.share(record)))

    compute_missing(journal, cases, choice, tell)
    return sorted(journal.rows(), key=lambda row: str(row["at"]))


def _identity(number: int, run: FinishedRun, folder: Path) -> Row:
    name = run.folder.relative_to(folder).as_posix() if run.folder != folder else run.folder.name
    return {"number": number, "run": name, "at": run.at.isoformat(timespec="seconds"), "rig": run.rig}
