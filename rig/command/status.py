"""peltier status: what the bench daemon's bench is doing.

Exit status 0 where a daemon answers, 1 where none does, 11 where the output should be off and that is not confirmed.
"""

from __future__ import annotations

import argparse
import sys

from rig.core.outcome import NotConfirmedOff
from rig.daemon.asking import bench_argument, checked, json_argument, one_daemon, report, some_daemons, teller
from rig.daemon.client import NoDaemon
from rig.daemon.words import rows_of


def arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    json_argument(parser)


def main(options: argparse.Namespace) -> int:
    status = 0
    try:
        for client in some_daemons(options.bench) if options.json is None else [one_daemon(options.bench)]:
            with client:
                state = checked(client.ask("state"))["state"]
            report(options.json, state)
            print(f"{state['name']}, peltier-rig {state['version']}", file=teller(options.json))
            for what, how in rows_of(state):
                print(f"  {what:<14} {how}", file=teller(options.json))
            if state["output"] == "unknown":
                status = NotConfirmedOff.exit_status
    except NoDaemon as error:
        print(f"peltier status: {error}", file=sys.stderr)
        return 1
    return status
