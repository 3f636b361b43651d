"""Many records, each by itself and side by side, told as they end: `identify --each`, and `diagnose` of several."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rig.command.many_arguments import engine_choice
from rig.command.many_progress import ManyProgress
from rig.command.say import Voice
from rig.core.faults import Faults
from rig.core.outcome import Stopped
from rig.records.record import Record, Refused

if TYPE_CHECKING:
    from rig.report.many_records import Task
    from rig.report.told import Told


def each_told(records: Sequence[Record | Refused], task: Task, options: argparse.Namespace, voice: Voice) -> int:
    """Writes the documents, in the order of the records, as the verb's JSON, and returns its exit status: 2 where one
    of the records has none, which is told at the end. Raises Faults where none has."""
    from rig.report.many_records import each_record

    for record in records:
        if isinstance(record, Refused):  # at once, for whoever had rather mend it first than wait for the others
            print(f"{record.source}: is refused, the others go on; the end says why", file=sys.stderr, flush=True)
    told: list[str] = []
    with ManyProgress() as progress:

        def tell(done: int, of: int, source: str, found: Told) -> None:
            for line in found.faults:
                progress.say(line)
                told.append(line)
            if found.lines:
                progress.clear()
                voice.say(f"{source}:")
            for line in found.lines:
                voice.say(line)
            progress.show(done, of)

        try:
            documents, faults, others = each_record(records, task, options.report, engine_choice(options), tell)
        except (Stopped, OSError):  # a full disk, too, stops the rest
            progress.say(_kept(options.report))
            raise
    if not documents:
        raise Faults(line for line in faults if line not in told)
    for record in records:
        for line in record.faults if isinstance(record, Refused) else ():
            print(line, file=sys.stderr)
    if len(documents) < len(records):
        missing = len(records) - len(documents)
        voice.say(f"{missing} of {len(records)} records could not be taken: stderr says why; the others are done")
    if others:
        what = f"{others} results of records that are none of these, or had other contents then"
        voice.say(f"{options.report}: {what}: left as they are, and not in the table")
    if options.report is not None:
        voice.say(f"report: {options.report / 'report.html'}")
    voice.report(documents)
    return 2 if faults else 0


def _kept(report: Path | None) -> str:
    """What becomes of the records that were done when somebody stops the rest."""
    if report is None:
        return "the records that were done are told above and kept nowhere; --report DIR keeps them"
    return f"{report}: the records that were done are kept; the same command goes on with the others"
