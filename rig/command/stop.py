"""peltier stop: the output off at once, the running job ended, the waiting ones taken out of the queue.

It talks to the daemon's bench process itself, so that it works without the page. Exit status 11 if the controller did
not confirm that its output is off.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

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
    return stop_all(clients, "peltier stop", options.json)


def stop_all(clients: list[Client], by: str, target: str | None) -> int:
    """Stop daemons, then print what they answered, then write it as JSON; return the exit status."""
    answers = [(client.path.stem, _stopped(client, by)) for client in clients]  # all, before a disk or a pipe is used
    status = max(_reported(name, answer, by, target) for name, answer in answers)
    try:
        for _, answer in answers:
            if not isinstance(answer, Exception):
                write_json(target, answer)
    except OSError as error:
        print(f"{by}: {error}", file=sys.stderr)
        status = max(status, 1)
    return status


def _stopped(client: Client, by: str) -> dict[str, Any] | Exception:
    try:
        with client:
            return dict(client.ask("POST", "/api/stop", by=by))
    except (NoDaemon, Refusal) as error:
        return error


def _reported(name: str, answer: dict[str, Any] | Exception, by: str, target: str | None) -> int:
    """Print a daemon's answer, or why there is none; return the exit status."""
    if isinstance(answer, Exception):
        print(f"{by}: OUTPUT NOT CONFIRMED OFF: {answer}. Switch the controller off by hand.", file=sys.stderr)
        return NotConfirmedOff.exit_status
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
