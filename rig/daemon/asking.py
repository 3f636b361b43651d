"""What the verbs that talk to a daemon have in common: which daemon, and what its refusals become. Import-light."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from rig.core.faults import Faults
from rig.core.file_writing import write_text
from rig.daemon.client import Client, NoDaemon, daemons

NONE_RUNS = "no daemon runs here (`peltier serve CONFIG` starts one)"


def bench_argument(parser: argparse.ArgumentParser) -> None:
    """--bench NAME, for a computer with several."""
    parser.add_argument("--bench", metavar="NAME", help="which daemon, where several run (serve.name)")


def json_argument(parser: argparse.ArgumentParser) -> None:
    """--json FILE."""
    parser.add_argument("--json", metavar="FILE", help="write the answer as JSON; - is stdout")


def some_daemons(name: str | None) -> list[Client]:
    """Every daemon, or the one of a name. Raises NoDaemon where there is none."""
    found = daemons()
    if name is not None:
        for client in found:
            if client.path.stem != name:
                client.close()
        found = [client for client in found if client.path.stem == name]
    if not found:
        raise NoDaemon(NONE_RUNS if name is None else f"no daemon called {name!r} runs here")
    return found


def one_daemon(name: str | None) -> Client:
    """The daemon that is meant. Raises Faults where several could be, NoDaemon where there is none."""
    found = some_daemons(name)
    if len(found) > 1:
        for client in found:
            client.close()
        raise Faults([f"--bench: missing; expected one of {', '.join(client.path.stem for client in found)}"])
    return found[0]


def checked(answer: dict[str, Any]) -> dict[str, Any]:
    """The answer. Raises Faults where it is a refusal."""
    if not answer.get("ok"):
        raise Faults(answer.get("faults", ["the daemon refused without a reason"]))
    return answer


def report(target: str | None, value: dict[str, Any]) -> None:
    """Write JSON where it was asked for; a file whole or not at all. Raises OSError, which names the file."""
    if target is None:
        return
    text = json.dumps({key: entry for key, entry in value.items() if key != "ok"}, indent=2) + "\n"
    if target == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        write_text(Path(target), text)


def teller(target: str | None) -> Any:
    """Where lines for people go: stderr where stdout belongs to --json."""
    return sys.stderr if target == "-" else sys.stdout
