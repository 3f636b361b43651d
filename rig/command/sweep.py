"""peltier sweep CONFIG: many simulated experiments, a table of what came out.

The configuration's [sweep] says what is varied, every value with every other:

    [sweep]
    seeds = 5                                          # or a list of seeds
    effects = [[], ["film_lag:tau_s=2"], ["creep"]]    # what is switched on beyond the configuration
    [sweep.parameters]                                 # any key of the configuration
    "control.ms" = [1.2, 1.4, 1.8]

A row goes to DIR/sweep.csv as soon as its experiment is done; begun again with the same DIR, the sweep goes on with
what is missing.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rig.command.record_arguments import add_json_argument


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("sweep"), help="default: sweep/")
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: one a core")
    parser.add_argument("--records", action="store_true", help="keep every record in DIR")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.command.say import Voice
    from rig.rehearsal.swept import sweep

    voice = Voice(options.json)

    def tell(done: int, of: int, line: str) -> None:
        print(f"{done}/{of} {line}", file=sys.stderr, flush=True)

    rows = sweep(options.config, options.out, options.workers, options.records, tell)
    failed = sum(1 for row in rows if row["status"] != "done")
    voice.say(f"{len(rows)} experiments, {failed} of them ended early or failed: {options.out / 'sweep.csv'}")
    voice.report({"format": "peltier-sweep/1", "table": options.out / "sweep.csv", "rows": rows})
    return 0
