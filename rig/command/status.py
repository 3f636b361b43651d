"""peltier status: what the bench daemon's bench is doing.

Exit status 0 where a daemon answers, 1 where none does, 11 where the output should be off and that is not confirmed.
"""

from __future__ import annotations

import argparse
import sys

from rig.core.outcome import NotConfirmedOff
from rig.daemon.client import (
    NoDaemon,
    bench_argument,
    daemons_called,
    json_argument,
    one_daemon,
    text_stream,
    write_json,
)
from rig.daemon.status_text import status_rows


def arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    json_argument(parser)


def main(options: argparse.Namespace) -> int:
    status = 0
    try:
        for client in daemons_called(options.bench) if options.json is None else [one_daemon(options.bench)]:
            with client:
                state = client.ask("GET", "/api/state")
            write_json(options.json, state)
            print(f"{state['name']}, peltier-rig {state['version']}", file=text_stream(options.json))
            for what, how in status_rows(state):
                print(f"  {what:<14} {how}", file=text_stream(options.json))
            if state["output"] == "unknown":
                status = NotConfirmedOff.exit_status
    except NoDaemon as error:
        print(f"peltier status: {error}", file=sys.stderr)
        return 1
    return status
