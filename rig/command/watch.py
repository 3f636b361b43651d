"""peltier watch: the bench as a live table, until Ctrl-C; without a terminal a line a second, with its time."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

from rig.core.faults import fault
from rig.daemon.client import Client, NoDaemon, bench_argument, one_daemon
from rig.daemon.status_text import status_rows, watch_line

EVERY_S = 0.25  # as often as anybody reads a changing number


def arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    parser.add_argument("--seconds", type=float, metavar="S", help="end after so long")


def main(options: argparse.Namespace) -> int:
    if options.seconds is not None and not options.seconds > 0.0:
        raise fault("--seconds", f"{options.seconds:g}", "expected a number of seconds > 0")
    end_s = time.monotonic() + options.seconds if options.seconds is not None else None
    try:
        with one_daemon(options.bench) as client:
            show = _table if sys.stdout.isatty() else _lines
            show(client, end_s)
    except NoDaemon as error:
        print(f"peltier watch: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:  # how one leaves it: the bench is as it was
        return 0
    return 0


def _states(client: Client, end_s: float | None) -> Any:
    """Yield the state, brought up to date by rows."""
    state: dict[str, Any] = {}
    for message in client.events():
        if message["event"] == "state":
            state = message["data"]
        elif message["event"] == "row" and state:
            state["reading"] = {**state["reading"], **message["data"]}
            state["time_s"] = message["data"]["time_s"]
        if state:
            yield state
        if end_s is not None and time.monotonic() >= end_s:
            return


def _table(client: Client, end_s: float | None) -> None:
    from rich.live import Live
    from rich.table import Table

    colour = {"running": "green", "tripped": "bold red", "stopped": "bold yellow", "offline": "bold red"}
    shown_s = 0.0
    with Live(auto_refresh=False) as live:
        for state in _states(client, end_s):
            if time.monotonic() - shown_s < EVERY_S:
                continue
            shown_s = time.monotonic()
            table = Table(title=f"{state['name']}  (Ctrl-C leaves; `peltier stop` stops)", show_header=False)
            for what, how in status_rows(state):
                style = colour.get(state["state"], "") if what in ("state", "trip", "stop") else ""
                style = "bold red" if what == "output" and not state["output_confirmed"] else style
                table.add_row(what, how, style=style)
            live.update(table, refresh=True)


def _lines(client: Client, end_s: float | None) -> None:
    shown_s = 0.0
    for state in _states(client, end_s):
        if time.monotonic() - shown_s < 1.0:
            continue
        shown_s = time.monotonic()
        print(watch_line(state), flush=True)
