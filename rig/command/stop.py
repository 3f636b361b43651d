"""peltier stop: the output off at once, the running job ended, the waiting ones taken out of the queue.

It talks to the daemon's bench process itself, so that it works without the page. Exit status 11 if the controller did
not confirm that its output is off.
"""

from __future__ import annotations

import argparse
import sys

from rig.core.outcome import NotConfirmedOff
from rig.daemon.client import (
    Client,
    NoDaemon,
    Refusal,
    bench_argument,
    daemons_called,
    json_argument,
    text_stream,
    write_json,
)


def arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    json_argument(parser)


def main(options: argparse.Namespace) -> int:
    try:
        clients = daemons_called(options.bench)
    except NoDaemon as error:
        print(f"peltier stop: {error}; `peltier off CONFIG` needs none", file=sys.stderr)
        return 1
    return max(stopped(client, "peltier stop", options.json) for client in clients)


def stopped(client: Client, by: str, target: str | None) -> int:
    """Stop one daemon and print its answer; return the exit status."""
    name = client.path.stem
    try:
        with client:
            answer = client.ask("POST", "/api/stop", by=by)
    except (NoDaemon, Refusal) as error:
        print(f"{by}: OUTPUT NOT CONFIRMED OFF: {error}. Switch the controller off by hand.", file=sys.stderr)
        return NotConfirmedOff.exit_status
    write_json(target, answer)
    if not answer.get("confirmed"):
        print(
            f"{by}: OUTPUT NOT CONFIRMED OFF: the controller of {name} did not confirm it within "
            f"{answer.get('took_s', 0.0):.1f} s. Switch the controller off by hand.",
            file=sys.stderr,
        )
        return NotConfirmedOff.exit_status
    rests_on = f" ({answer['confirmed_by']})" if answer.get("confirmed_by") else ""
    text = f"{name}: output off, confirmed by the controller in {1e3 * answer['took_s']:.0f} ms{rests_on}"
    queue = "waiting jobs are out of the queue, and nothing begins until `peltier reset`"
    print(f"{text}; {queue}", file=text_stream(target), flush=True)
    return 0
