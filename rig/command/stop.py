"""peltier stop: the output off at once, the running job ended, the waiting ones taken out of the queue..

Asks the daemon's bench process itself, so that it works without the page. Exit status 11 where the controller did not
confirm that its output is off.
"""

from __future__ import annotations

import argparse
import sys

from rig.core.outcome import NotConfirmedOff
from rig.daemon.asking import bench_argument, json_argument, report, some_daemons, teller
from rig.daemon.client import Client, NoDaemon


def arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    json_argument(parser)


def main(options: argparse.Namespace) -> int:
    try:
        clients = some_daemons(options.bench)
    except NoDaemon as error:
        print(f"peltier stop: {error}; `peltier off CONFIG` needs none", file=sys.stderr)
        return 1
    return max(stopped(client, "peltier stop", options.json) for client in clients)


def stopped(client: Client, by: str, target: str | None) -> int:
    """Stop one daemon, and print its answer: the exit status."""
    name = client.path.stem
    try:
        with client:
            answer = client.ask("stop", by=by)
    except NoDaemon as error:
        print(f"{by}: OUTPUT NOT CONFIRMED OFF: {error}. Switch the controller off by hand.", file=sys.stderr)
        return NotConfirmedOff.exit_status
    report(target, answer)
    if not answer.get("confirmed"):
        print(
            f"{by}: OUTPUT NOT CONFIRMED OFF: the controller of {name} did not confirm it within "
            f"{answer.get('took_s', 0.0):.1f} s. Switch the controller off by hand.",
            file=sys.stderr,
        )
        return NotConfirmedOff.exit_status
    rests_on = f" ({answer['confirmed_by']})" if answer.get("confirmed_by") else ""
    text = f"{name}: output off, confirmed by the controller in {1e3 * answer['took_s']:.0f} ms{rests_on}"
    queue = "what waited is out of the queue, and nothing begins until `peltier reset`"
    print(f"{text}; {queue}", file=teller(target), flush=True)
    return 0
