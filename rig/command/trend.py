"""peltier trend FOLDER: find which effects the runs in a folder show, how large, and since when.

Every complete run below FOLDER is diagnosed once: the results are kept in DIR/cases.jsonl, and the next time only new
runs are diagnosed. DIR/report.html has the series of every effect with their 95 %
intervals, DIR/effects.csv one line an effect (since when, before, after), DIR/trend.csv and DIR/trend.nc one row a run.
A change is reported at a false-alarm rate of 5 % per series, however often the command is run.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rig.command.batch import add_engine_arguments, engine_choice
from rig.command.progress import CaseProgress
from rig.command.record_arguments import add_json_argument
from rig.command.terminal import Terminal


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="with run folders in it, at any depth")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("trend"), help="default: trend/")
    add_engine_arguments(parser)
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
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
