"""peltier sweep CONFIG: many cases of one configuration, a table of what came out.

The configuration's [sweep] says what is varied:

    [sweep]
    seeds = 5                                          # or a list of seeds
    effects = [[], ["film_lag:tau_s=2"], ["creep"]]    # what is switched on beyond the configuration
    what = "experiment"                                # or "identification", "diagnosis" of each one's record
    [sweep.parameters]                                 # any key of the configuration: every value with every other
    "control.ms" = [1.2, 1.4, 1.8]

or, in the place of parameters, plan = "latin_hypercube" with samples = 100 and [sweep.ranges] "control.ms" = [1.2, 2];
or, in the place of simulated experiments, records = ["evening/*.csv"] to identify or to diagnose.

Each case is a line of DIR/cases.jsonl as soon as it ends; DIR/sweep.csv and, at the end, DIR/sweep.nc and DIR/sweep.svg
are the table. Begun again with the same DIR, whatever interrupted it, the sweep goes on with what is missing. A case
that fails, or whose process is killed, is a row that says so, and stops nothing.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from rig.command.batch import add_engine_arguments, announce_refused, engine_choice, print_refused
from rig.command.progress import CaseProgress
from rig.command.record_arguments import add_json_argument
from rig.command.terminal import Terminal


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("sweep"), help="default: sweep/")
    add_engine_arguments(parser)
    parser.add_argument("--records", action="store_true", help="keep every record in DIR")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
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
