"""Many records, each by itself and side by side, told as they end: `identify --each`, and `diagnose` of several."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from rig.command.many_arguments import engine_choice
from rig.command.many_progress import ManyProgress
from rig.command.say import Voice
from rig.core.faults import Faults

if TYPE_CHECKING:
    from rig.files.record_file import Record
    from rig.report.many_records import Task
    from rig.report.told import Told


def each_told(records: list[Record], task: Task, options: argparse.Namespace, voice: Voice) -> int:
    """Writes the documents, in the order of the records, as the verb's JSON, and returns its exit status: 2 where one
    of the records has none, which was told. Raises Faults where none has."""
    from rig.report.many_records import each_record

    with ManyProgress() as progress:

        def tell(done: int, of: int, record: Record, found: Told) -> None:
            for line in found.faults:
                progress.say(line)
            if found.lines:
                progress.clear()
                voice.say(f"{record.source}:")
            for line in found.lines:
                voice.say(line)
            progress.show(done, of)

        documents, faults = each_record(records, task, options.report, engine_choice(options), tell)
    if not documents:
        raise Faults(faults)
    if options.report is not None:
        voice.say(f"report: {options.report / 'report.html'}")
    voice.report(documents)
    return 2 if faults else 0
