"""Verbs with many cases, sweep and trend, and what each verb of many records shares: engine, reports as they end."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.command.record_arguments import add_json_argument
from rig.command.terminal import CaseProgress, Terminal
from rig.core.faults import Faults
from rig.core.outcome import Stopped
from rig.records.record import Record, Refused

if TYPE_CHECKING:
    from rig.batch import EngineChoice
    from rig.report.batch import RecordReport, Task


def add_engine_arguments(parser: argparse._ActionsContainer) -> None:
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


def sweep_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("sweep"), help="default: sweep/")
    add_engine_arguments(parser)
    parser.add_argument("--records", action="store_true", help="keep every record in DIR")
    add_json_argument(parser)


def sweep(options: argparse.Namespace) -> int:
    """peltier sweep CONFIG: many cases of one configuration, a table of what came out.

    The configuration's [sweep] says what is varied:

        [sweep]
        seeds = 5                                          # or a list of seeds
        effects = [[], ["film_lag:tau_s=2"], ["creep"]]    # what is switched on beyond the configuration
        what = "experiment"                                # or "identification", "diagnosis" of each one's record
        [sweep.parameters]                                 # any key of the configuration: every value with every other
        "control.ms" = [1.2, 1.4, 1.8]

    or, in the place of parameters, plan = "latin_hypercube" with samples = 100 and [sweep.ranges] "control.ms" = [1.2,
    2]; or, in the place of simulated experiments, records = ["evening/*.csv"] to identify or to diagnose.

    Each case is a line of DIR/cases.jsonl as soon as it ends; DIR/sweep.csv and, at the end, DIR/sweep.nc and
    DIR/sweep.svg are the table. Begun again with the same DIR, whatever interrupted it, the sweep goes on with what is
    missing. A case that fails, or whose process is killed, is a row that says so, and stops nothing.
    """
    from rig.experiment.sweep import read_sweep, row_in_words, sweep
    from rig.records.record import Refused

    terminal = Terminal(options.json)
    choice = engine_choice(options)
    todo = read_sweep(options.config)
    announce_refused(todo.records)
    for record in todo.records:
        for line in () if isinstance(record, Refused) else record.notes:
            print(f"{record.source}: {line}", file=sys.stderr)
    with CaseProgress() as progress:

        def on_done(done: int, of: int, row: dict[str, Any]) -> None:
            if row["status"] != "done":
                progress.print(row_in_words(row))
            progress.show(done, of)

        rows = sweep(todo, options.out, choice, options.records, on_done)
    print_refused(todo.records)
    failed = sum(1 for row in rows if row["status"] != "done")
    terminal.print(f"{len(rows)} cases, {failed} of them ended early or failed: {options.out / 'sweep.csv'}")
    from rig.report.batch import draw_sweep

    figure = draw_sweep(rows, options.out / "sweep.svg")
    if figure is not None:
        terminal.print(f"figure: {figure}")
    terminal.write_json({"format": "peltier-sweep/1", "table": options.out / "sweep.csv", "rows": rows})
    return 2 if any(isinstance(record, Refused) for record in todo.records) else 0


def trend_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="with run folders in it, at any depth")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("trend"), help="default: trend/")
    add_engine_arguments(parser)
    add_json_argument(parser)


def trend(options: argparse.Namespace) -> int:
    """peltier trend FOLDER: find which effects the runs in a folder show, how large, and since when.

    Every complete run below FOLDER is diagnosed once: the results are kept in DIR/cases.jsonl, and the next time only
    new runs are diagnosed. DIR/report.html has the series of every effect with their 95 % intervals, DIR/effects.csv
    one line an effect (since when, before, after), DIR/trend.csv and DIR/trend.nc one row a run. A change is reported
    at a false-alarm rate of 5 % per series, however often the command is run.
    """
    from rig.analysis.trend import series_of
    from rig.experiment.sweep import diagnose_runs
    from rig.records.run_folder import find_runs
    from rig.report.batch import write_trend_report

    terminal = Terminal(options.json)
    choice = engine_choice(options)
    runs = find_runs(options.folder)
    with CaseProgress() as progress:

        def on_done(done: int, of: int, row: dict[str, Any]) -> None:
            if row["status"] != "done":
                progress.print(f"{row['run']}: {row.get('text', '')}")
            progress.show(done, of)

        rows = diagnose_runs(runs, options.folder, options.out, choice, on_done)
    series = series_of(rows)
    for one in series:
        terminal.print(one.in_words())
    if not series:
        terminal.print(f"no effect was named in {len(rows)} runs")
    from rig.batch import table_columns
    from rig.records.record_file import write_columns

    write_columns(options.out / "effects.csv", table_columns([one.row() for one in series]))
    linked = [{**row, "link": _link(options.folder / str(row["run"]) / "report.html", options.out)} for row in rows]
    write_trend_report(options.out, series, linked)
    terminal.print(f"report: {options.out / 'report.html'}")
    terminal.write_json({"format": "peltier-trend/1", "effects": [one.row() for one in series], "runs": rows})
    return 0


def _link(report: Path, out: Path) -> str:
    """Return the address of a run's report from the page; "" if it has none."""
    import os

    return Path(os.path.relpath(report.resolve(), out.resolve())).as_posix() if report.is_file() else ""
