"""Verbs of a bench: status, watch, stop, off and reset, with the daemon or, for off, without one."""

from __future__ import annotations

import argparse
import os
import sys
import time
from contextlib import suppress

from rig.core.faults import Faults, fault
from rig.core.outcome import NotConfirmedOff
from rig.daemon.client import (
    Client,
    NoDaemon,
    Refusal,
    bench_argument,
    daemons,
    daemons_called,
    json_argument,
    one_daemon,
    text_stream,
    write_json,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from rig.core.errors import PortHeld
    from rig.drivers.controller import TemperatureController
    from rig.guard.takeover import Held


def status_arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    json_argument(parser)


def status(options: argparse.Namespace) -> int:
    """peltier status: what the bench daemon's bench is doing.

    Exit status 0 where a daemon answers, 1 where none does, 11 where the output should be off and that is not
    confirmed.
    """
    from rig.daemon.status_text import status_rows

    status = 0
    for client in daemons_called(options.bench) if options.json is None else [one_daemon(options.bench)]:
        with client:
            state = client.ask("GET", "/api/state")
        write_json(options.json, state)
        print(f"{state['name']}, peltier-rig {state['version']}", file=text_stream(options.json))
        for what, how in status_rows(state):
            print(f"  {what:<14} {how}", file=text_stream(options.json))
        if state["output"] == "unknown":
            status = NotConfirmedOff.exit_status
    return status


EVERY_S, LINE_EVERY_S = 0.25, 1.0  # as often as anybody reads a changing number, and a line


def watch_arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    parser.add_argument("--seconds", type=float, metavar="S", help="end after so long")


def watch(options: argparse.Namespace) -> int:
    """peltier watch: the bench as a live table, until Ctrl-C; without a terminal a line a second, with its time."""
    if options.seconds is not None and not options.seconds > 0.0:
        raise fault("--seconds", f"{options.seconds:g}", "expected a number of seconds > 0")
    end_s = time.monotonic() + options.seconds if options.seconds is not None else None
    # Ctrl-C is how one leaves it: the bench is as it was
    with suppress(KeyboardInterrupt), one_daemon(options.bench) as client:
        show = _table if sys.stdout.isatty() else _lines
        show(client, end_s)
    return 0


def _states(client: Client, end_s: float | None, every_s: float) -> Any:
    """Yield the state, brought up to date by rows, at most once in every_s (s)."""
    state: dict[str, Any] = {}
    shown_s = 0.0
    for message in client.events():
        if message["event"] == "state":
            state = message["data"]
        elif message["event"] == "row" and state:
            state["reading"] = {**state["reading"], **message["data"]}
            state["time_s"] = message["data"]["time_s"]
        if state and time.monotonic() - shown_s >= every_s:
            shown_s = time.monotonic()
            yield state
        if end_s is not None and time.monotonic() >= end_s:
            return


def _table(client: Client, end_s: float | None) -> None:
    from rich.live import Live
    from rich.table import Table

    from rig.daemon.status_text import status_rows

    colour = {"running": "green", "tripped": "bold red", "stopped": "bold yellow", "offline": "bold red"}
    with Live(auto_refresh=False) as live:
        for state in _states(client, end_s, EVERY_S):
            table = Table(title=f"{state['name']}  (Ctrl-C leaves; `peltier stop` stops)", show_header=False)
            for what, how in status_rows(state):
                style = colour.get(state["state"], "") if what in ("state", "trip", "stop") else ""
                style = "bold red" if what == "output" and not state["output_confirmed"] else style
                table.add_row(what, how, style=style)
            live.update(table, refresh=True)


def _lines(client: Client, end_s: float | None) -> None:
    from rig.daemon.status_text import watch_line

    for state in _states(client, end_s, LINE_EVERY_S):
        print(watch_line(state), flush=True)


def stop_arguments(parser: argparse.ArgumentParser) -> None:
    bench_argument(parser)
    json_argument(parser)


def stop(options: argparse.Namespace) -> int:
    """peltier stop: the output off at once, the running job ended, the waiting ones taken out of the queue.

    It talks to the daemon's bench process itself, so that it works without the page. Exit status 11 if the controller
    did not confirm that its output is off.
    """
    try:
        clients = daemons_called(options.bench)
    except NoDaemon as error:
        print(f"peltier stop: {error}; `peltier off CONFIG` needs none", file=sys.stderr)
        return 1
    return stop_all(clients, "peltier stop", options.json)


def stop_all(clients: list[Client], by: str, target: str | None) -> int:
    """Stop daemons, then print what they answered, then write it as JSON; return the exit status."""
    answers = [(client.name, _stopped(client, by)) for client in clients]  # all, before a disk or a pipe is used
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


PATIENCE_S = 5.0  # for a port that cannot be opened
ENDS_S = 15.0  # all of it but the dead man's time: that patience, an imported driver, the off, a look
SIMULATED = "sim://"  # how the port of a simulated instrument begins
DEAD_MAN_S = 5.0  # where the configuration does not say (rig.config.configuration)


def off_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", nargs="?", help="configuration that names the controller (TOML)")
    json_argument(parser)


def off(options: argparse.Namespace) -> int:
    """peltier off [CONFIG]: the output off, with a daemon or without.

    Where daemons run, the one that holds CONFIG's controller stops (without CONFIG every one). Where none does, the
    controller that CONFIG names is opened and commanded off. A simulated controller (sim://) has no identity: that of
    CONFIG is held by the daemon that was started with this very file, and by no other. Exit status 11 where that is not
    confirmed, 75 where another process holds the port. A process that still tries to switch the output off, after that
    was not confirmed, is ended, and this one tries instead.
    """
    try:
        return _off(options)
    except Faults as faults:  # before anything was sent
        hand = "peltier off: nothing was sent, and the output may be on. Switch the controller off by hand."
        raise Faults([*faults.lines, hand]) from None


def _off(options: argparse.Namespace) -> int:
    """Stop the daemons, or open the controller. Raises Faults, PortHeld; then nothing was sent."""
    held = _controller(options.config) if options.config is not None else None
    clients = daemons()
    if held is None:
        if not clients:
            raise fault(
                "peltier off", "", "no daemon runs here; name the CONFIG of the controller: `peltier off CONFIG`"
            )
        return stop_all(clients, "peltier off", options.json)
    simulated = held.port.startswith(SIMULATED)
    holders = [c for c in clients if (_serves(c, options.config) if simulated else _holds(c, held.port))]
    others = [client for client in clients if client not in holders]
    for client in others:
        client.close()
    if holders:
        return stop_all(holders, "peltier off", options.json)
    if simulated:
        return _nothing_on(held.port, options.config, [client.name for client in others], options.json)
    return _switched_off(held, options.json)


def _nothing_on(port: str, config: str, others: list[str], target: str | None) -> int:
    """Report that nobody simulates this configuration's rig. others: daemons that run, of other configurations."""
    write_json(target, {"off": True, "confirmed": True, "took_s": 0.0})
    text = f"{port}: simulated, and no daemon serves {config}: nothing is on"
    if others:
        text += f"; left alone: {', '.join(others)} (`peltier stop --bench NAME` stops one)"
    print(text, file=text_stream(target), flush=True)
    return 0


def _controller(config: str) -> Held:
    """Return what opens the controller, without the schema, which takes longer to load than the rest."""
    from pathlib import Path

    from rig.config.toml_file import read_toml
    from rig.drivers.registry import beside
    from rig.guard.takeover import Held

    path = Path(config)
    try:
        table = read_toml(path)["bench"]["controller"]
        driver, port = table["driver"], table["port"]
        more = dict(table.get("options", {}))
    except (KeyError, TypeError, ValueError, AttributeError):
        raise fault(path, "bench.controller", "expected driver and port") from None
    if not (isinstance(driver, str) and isinstance(port, str)):
        raise fault(path, "bench.controller", "expected driver and port as text")
    driver = beside(driver, path.parent)
    if "baud" in table:
        more["baud"] = table["baud"]
    dead_man_s = table.get("dead_man_s", DEAD_MAN_S)
    return Held("controller", driver, port, more, float(dead_man_s) if isinstance(dead_man_s, int | float) else 0.0)


def _who(client: Client) -> dict[str, Any]:
    """Return a daemon's answer on itself; empty if it has none."""
    try:
        return dict(client.ask("GET", "/daemon"))
    except (NoDaemon, Refusal):
        return {}


def _serves(client: Client, config: str) -> bool:
    """Return True if a daemon was started with this file."""
    served = _who(client).get("configuration")
    return isinstance(served, str) and os.path.realpath(served) == os.path.realpath(config)


def _holds(client: Client, port: str) -> bool:
    """Return True if a daemon holds this real port."""
    ports = _who(client).get("ports", [])
    return any(port == held or os.path.realpath(port) == os.path.realpath(held) for held in ports)


def _switched_off(held: Held, target: str | None) -> int:
    """Open the port and command the output off. Raises Faults, PortHeld."""
    from rig.daemon.systemd import Notifier
    from rig.guard.takeover import keep_trying
    from rig.ports.transport import nobody_answers
    from rig.safety.switching_off import off_confirmed, switch_off

    begin = time.monotonic()
    notifier = Notifier()
    notifier.ends(ENDS_S + held.dead_man_s)
    notifier.close()
    controller, problem, doubted = _opened(held)
    if controller is not None:
        try:
            verdict = switch_off(controller, held.dead_man_s)
        finally:
            controller.close()
        took_s = time.monotonic() - begin
        if verdict.confirmed and not doubted:
            write_json(target, {"off": True, "confirmed": True, "took_s": took_s})
            how = f": {verdict.text}" if verdict.text else ""
            text = off_confirmed(controller, f" in {1e3 * took_s:.0f} ms")
            print(f"{held.port}: {text}{how}", file=text_stream(target), flush=True)
            return 0
        silent = nobody_answers(controller, held.port, "controller", held.driver, "to switch its output off")
        problem = silent or f"{held.port}: {verdict.text}"
        if verdict.confirmed:
            problem = f"{held.port}: the controller says now that its output is off, but before it did not confirm that"
    write_json(target, {"off": False, "confirmed": False, "took_s": time.monotonic() - begin})
    print(f"peltier off: OUTPUT NOT CONFIRMED OFF: {problem}. Switch the controller off by hand.", file=sys.stderr)
    if controller is not None and not verdict.confirmed:
        keep_trying(held)
    return NotConfirmedOff.exit_status


def _opened(held: Held) -> tuple[TemperatureController | None, str, bool]:
    """Open the controller on its port; return it, or None and what stood in the way, and True if another process had to
    give up on it.

    Raises Faults, PortHeld.
    """
    from rig.core.clock import RealClock
    from rig.core.errors import PortHeld
    from rig.drivers.registry import controller_class, open_controller
    from rig.guard.takeover import end_trying

    try:
        controller_class(held.driver)
    except ValueError as error:
        raise fault("bench.controller.driver", "", str(error)) from None
    begin, problem, doubted = time.monotonic(), "", False
    while time.monotonic() - begin < PATIENCE_S:
        try:
            return open_controller(held.driver, held.port, RealClock(), **held.options), "", doubted
        except PortHeld as error:
            if not (end_trying(error.pid) or doubted):
                raise _still_held(error) from None
            doubted, problem = True, str(error)
        except ValueError as error:
            raise fault("bench.controller.options", "", str(error)) from None
        except Exception as error:  # a port that is not there; and a driver of the user's own may do anything
            problem = str(error)
        time.sleep(0.02)
    return None, problem, doubted


def _still_held(error: PortHeld) -> PortHeld:
    end = "stopping that process" if error.pid is None else f"`kill {error.pid}`, or Ctrl-C where it runs,"
    error.add_note(
        "nothing was sent, and the output may be on: "
        f"{end} ends a `peltier run` or `calibrate` with its output off; of another program switch the controller off "
        "by hand"
    )
    return error


def reset_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--reason", required=True, metavar="TEXT", help="why it is safe to go on; it is kept")
    bench_argument(parser)


def reset(options: argparse.Namespace) -> int:
    """peltier reset --reason TEXT: clear a latched trip or stop. Jobs that wait begin then, so look at the queue first.

    What waited when somebody stopped the bench is out of the queue, and begins only when it is asked for again.
    """
    try:
        with one_daemon(options.bench) as client:
            waiting = client.ask("POST", "/api/reset", reason=options.reason)["queue"]
    except Refusal as refusal:
        if refusal.status not in (409, 503):  # nothing is latched; or it stays latched, as it cannot be written
            raise
        print(f"peltier reset: {refusal}", file=sys.stderr)
        return 1
    jobs = "1 job waits and goes" if waiting == 1 else f"{waiting} jobs wait and go"
    print(f"reset; {jobs} on now" if waiting else "reset; no job waits")
    return 0
