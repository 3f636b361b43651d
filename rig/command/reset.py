"""peltier reset --reason TEXT: clear a latched trip or stop. Jobs that wait begin then, so look at the queue first.

What waited when somebody stopped the bench is out of the queue, and begins only when it is asked for again.
"""

from __future__ import annotations

import argparse
import sys

from rig.daemon.client import NoDaemon, Refusal, bench_argument, one_daemon


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--reason", required=True, metavar="TEXT", help="why it is safe to go on; it is kept")
    bench_argument(parser)


def main(options: argparse.Namespace) -> int:
    try:
        with one_daemon(options.bench) as client:
            waiting = client.ask("POST", "/api/reset", reason=options.reason)["queue"]
    except NoDaemon as error:
        print(f"peltier reset: {error}", file=sys.stderr)
        return 1
    except Refusal as refusal:
        if refusal.status not in (409, 503):  # nothing is latched; or it stays latched, as it cannot be written
            raise
        print(f"peltier reset: {refusal}", file=sys.stderr)
        return 1
    jobs = "1 job waits and goes" if waiting == 1 else f"{waiting} jobs wait and go"
    print(f"reset; {jobs} on now" if waiting else "reset; no job waits")
    return 0
