"""What verbs with many cases share: arguments of the engine, and many records, each reported as it ends."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rig.command.progress import CaseProgress
from rig.command.terminal import Terminal
from rig.core.faults import Faults
from rig.core.outcome import Stopped
from rig.records.record import Record, Refused

if TYPE_CHECKING:
    from rig.batch import EngineChoice
    from rig.report.batch import RecordReport, Task


def add_engine_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --workers, --engine, --address."""
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: one a core")
    parser.add_argument(
        "--engine", default="processes", metavar="NAME", help="processes (default) or dask (extra 'cluster')"
    )
    parser.add_argument(
        "--address", metavar="tcp://...", help="of a Dask scheduler; without it Dask begins a cluster on this computer"
    )


def engine_choice(options: argparse.Namespace) -> EngineChoice:
    """Return the engine that was chosen. Raises Faults."""
    from rig.batch import EngineChoice

    return EngineChoice(options.engine, options.workers, options.address)


def announce_refused(records: Sequence[Record | Refused]) -> None:
    """Print which records are refused, at once: somebody may want to mend one before the others are done."""
    for record in records:
        if isinstance(record, Refused):
            print(f"{record.source}: is refused, the others go on; the end says why", file=sys.stderr, flush=True)


def print_refused(records: Sequence[Record | Refused]) -> None:
    """Print why records are refused."""
    for line in (line for record in records if isinstance(record, Refused) for line in record.faults):
        print(line, file=sys.stderr)


def report_each(
    records: Sequence[Record | Refused], task: Task, options: argparse.Namespace, terminal: Terminal
) -> int:
    """Do a task with each record, print each result as it ends, and write all documents as the verb's JSON.

    Returns the exit status: 2 if a record has no document, which is printed at the end. Raises Faults if none has.
    """
    from rig.report.batch import each_record

    announce_refused(records)
    printed: list[str] = []
    with CaseProgress() as progress:

        def on_done(done: int, of: int, source: str, found: RecordReport) -> None:
            for line in found.faults:
                progress.print(line)
                printed.append(line)
            if found.lines:
                progress.clear()
                terminal.print(f"{source}:")
            for line in found.lines:
                terminal.print(line)
            progress.show(done, of)

        try:
            documents, faults, others = each_record(records, task, options.report, engine_choice(options), on_done)
        except (Stopped, OSError):  # a full disk, too, stops the rest
            kept = "the records that were done are printed above and kept nowhere; --report DIR keeps them"
            if options.report is not None:
                kept = "the records that were done are kept; the same command goes on with the others"
                kept = f"{options.report}: {kept}"
            progress.print(kept)
            raise
    if not documents:
        raise Faults(line for line in faults if line not in printed)
    print_refused(records)
    if len(documents) < len(records):
        missing = len(records) - len(documents)
        terminal.print(f"{missing} of {len(records)} records could not be taken: stderr says why; the others are done")
    if others:
        what = f"{others} results of records that are none of these, or had other contents then"
        terminal.print(f"{options.report}: {what}: left as they are, and not in the table")
    if options.report is not None:
        terminal.print(f"report: {options.report / 'report.html'}")
    terminal.write_json(documents)
    return 2 if faults else 0
