"""`peltier run` and `calibrate` on ports that a daemon holds: submitted as a job, and followed to its end.

    status = handed_over("run", options.config, options.out, options.json, options.bench)
    if status is not None:
        return status

The exit status is that of the verb by itself. Ctrl-C ends the job as it would end a run; a reader of stdout that goes
ends nothing. Import-light, so that it comes before the bench's own code is loaded.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.config.toml_file import read_toml
from rig.core.faults import Faults, fault
from rig.core.outcome import NotConfirmedOff, Stopped
from rig.core.streams import TerminalLine
from rig.daemon.client import (
    CALIBRATION,
    Client,
    NoDaemon,
    Refusal,
    daemons,
    one_daemon,
    text_stream,
    write_json,
)
from rig.daemon.status_text import off_in_words, progress_line
from rig.guard.stale_run import LOOK_AGAIN_S, end_of_last_run
from rig.safety.signals import SignalStop

HOLDING = ("tripped", "stopped", "offline")
NEVER_BEGAN = 1  # exit status of a job that still waited when its daemon ended: no output has to go off
DIED = 1  # exit status if the daemon's process died and the guard confirmed the output off
GUARD_S = 40.0  # for the guard's entry: it checks the temperature for 20 s, after a dead man's silence or two
ENDS_S = 10.0  # for a silent daemon to end; its page and its log take a second or two
SILENCE_S = 60.0  # a daemon sends its state every 5 s


@dataclass
class _Progress:
    """State of the job, from the events.

    waited: it waits, for another job or for the bench; False if it may have begun since. folder: of its rows, once it
    has begun.
    """

    waited: bool = False
    begun: bool = False
    folder: str | None = None

    def take(self, event: str, data: dict[str, Any], number: str) -> None:
        if event == "state":
            running = data["job"]["id"] if data["job"] is not None else None
            self.begun = self.begun or running == number
            self.waited = not self.begun and (running is not None or _held_by(data) is not None)
        elif event == "job" or data.get("job", data.get("id")) == number:
            mine = event != "job" or data["id"] == number
            self.begun = self.begun or (mine and (event != "job" or data.get("started_s") is not None))
            self.waited = False
            self.folder = (data.get("folder") if mine and event == "job" else None) or self.folder


def add_bench_argument(parser: argparse.ArgumentParser) -> None:
    """Add --bench NAME, for the verbs whose work a daemon can do."""
    parser.add_argument(
        "--bench", metavar="NAME", help="let this daemon do it (serve.name); needed if its ports are sim://"
    )


def handed_over(
    verb: str, config: Path, out: Path | None, json_target: str | None = None, bench: str | None = None
) -> int | None:
    """Return the job's exit status, or None if no daemon holds the configuration's ports. Raises Faults.

    bench: the daemon to be used, whatever the ports. Simulated ports are not shared: by itself a run with sim:// has a
    rig of its own.
    """
    if bench is not None:
        try:
            with one_daemon(bench) as client, Client(client.path, SILENCE_S) as stream:
                return _followed(verb, client, stream, config, out, json_target)
        except NoDaemon as error:
            raise fault("--bench", repr(bench), str(error)) from None
    ports = _ports(config)
    for client in daemons() if ports else []:
        with client:
            try:
                held = client.ask("GET", "/daemon").get("ports", [])
            except (NoDaemon, Refusal):
                continue
            if {os.path.realpath(port) for port in held} & ports:
                try:
                    with Client(client.path, SILENCE_S) as stream:
                        return _followed(verb, client, stream, config, out, json_target)
                except NoDaemon as error:
                    raise fault(config, "bench", f"a daemon has its ports, and takes no job: {error}") from None
    return None


def _ports(config: Path) -> set[str]:
    """Return the real ports of a configuration; none if it cannot be read, which is reported later."""
    try:
        bench = read_toml(config)["bench"]
        ports = [bench[role]["port"] for role in ("controller", "meter") if role in bench]
    except (Faults, KeyError, TypeError):
        return set()
    return {os.path.realpath(port) for port in ports if isinstance(port, str) and not port.startswith("sim://")}


def _followed(verb: str, client: Client, events_of: Client, config: Path, out: Path | None, target: str | None) -> int:
    """Submit the job and follow it. From the moment at which there may be a job, a signal ends it."""
    stream, progress = text_stream(target), _Progress()
    events = events_of.events(SILENCE_S)
    next(events)  # the state: no event is missed from here on
    more = {"out": str(out.absolute())} if out is not None else {}
    if verb == "calibrate":
        more["kind"] = CALIBRATION
    with SignalStop() as signals:
        signals.shield()  # a signal before the answer waits for it: then there is a job to end
        try:
            job = client.ask("POST", "/api/jobs", path=str(config.absolute()), **more)
        except NoDaemon as error:
            return _not_confirmed(verb, f"{error}, which may have begun the job; {_make_sure(config)}")
        try:
            signals.expose()
            text = f"handed over to the daemon {client.name}, which holds the ports, as job {job['id']}"
            print(text, file=stream, flush=True)
            job = _until_it_ends(events, job, stream, progress)
        except Stopped as stopped:
            signals.shield()
            try:
                return _ended_by(verb, client, job["id"], stopped.number)
            except NoDaemon as error:
                with SignalStop():  # another signal ends the waiting
                    return _without_daemon(verb, client, job["id"], progress, error, config)
        except NoDaemon as error:
            return _without_daemon(verb, client, job["id"], progress, error, config)
    return _report_end(verb, client, events, job, target)


def _without_daemon(verb: str, client: Client, number: str, progress: _Progress, error: NoDaemon, config: Path) -> int:
    """Find the exit status without events from the daemon."""
    if _still_answers(client, number, progress):
        return _not_confirmed(verb, f"{error} while the job ran; {_make_sure(config)}")
    if not progress.waited:
        return _by_the_guard(verb, progress.folder, f"{error} while the job ran", config)
    text = f"the job never began: {error} while it waited; submit it again when the daemon runs again"
    print(f"peltier {verb}: {text}; {_make_sure(config)}", file=sys.stderr)
    return NEVER_BEGAN


def _still_answers(client: Client, number: str, progress: _Progress) -> bool:
    """Return True if the daemon is still there, and only the events have ended. A daemon that ends answers for a moment
    longer, but begins no job any more."""
    until_s = time.monotonic() + ENDS_S
    with suppress(NoDaemon):
        while time.monotonic() < until_s:
            job = {}
            with suppress(Refusal):
                job = client.ask("GET", f"/api/jobs/{number}").get("job", {})
            progress.waited = job.get("state") == "queued"
            time.sleep(LOOK_AGAIN_S)
        return True
    return False


def _by_the_guard(verb: str, folder: str | None, why: str, config: Path) -> int:
    """Report the end of a job whose daemon died by the guard's entry, or where to find it. A signal ends the waiting,
    and confirms nothing."""
    found = None
    if folder is not None:
        print(f"peltier {verb}: {why}; waiting for its guard's entry in {folder}", file=sys.stderr, flush=True)
        with suppress(Stopped):
            found = end_of_last_run(folder, GUARD_S)
    if found is None:
        where = f", and in {folder}/run.json" if folder is not None else ""
        return _not_confirmed(verb, f"{why}; its guard's finding is in the daemon's log{where}; {_make_sure(config)}")
    confirmed, text = found
    if not confirmed:
        return _not_confirmed(verb, f"{text}. Switch the controller off by hand.")
    report = f"{folder}/report.html, or `peltier report {folder}` draws it"
    print(f"peltier {verb}: {text}; what was recorded is in {folder}; report: {report}", file=sys.stderr)
    return DIED


def _make_sure(config: Path) -> str:
    """Return what to do if no daemon answers any more."""
    return f"`peltier off {config}` switches the output off, if it is not, and confirms it"


def _not_confirmed(verb: str, why: str) -> int:
    print(f"peltier {verb}: OUTPUT NOT CONFIRMED OFF: {why}", file=sys.stderr)
    return NotConfirmedOff.exit_status


def _report_end(verb: str, client: Client, events: Any, job: dict[str, Any], target: str | None) -> int:
    """Report the job's end; return its exit status, or that of an output not confirmed off, which outranks it."""
    text, confirmed = _output_now(client, events)
    if job["exit_status"] == 0:
        result: dict[str, Any] = {}
        with suppress(NoDaemon, Refusal):  # the daemon has gone since: the job's folder has its result
            result = client.ask("GET", f"/api/jobs/{job['id']}").get("result") or {}
        write_json(target, result)
    if job["exit_status"] == 0 and confirmed:
        print(f"{text}\nreport: {job['folder']}/report.html", file=text_stream(target), flush=True)
    else:
        place = f"; what was recorded is in {job['folder']}" if job["folder"] else ""
        place += f"; report: {job['folder']}/report.html" if job.get("report") else ""
        print(f"peltier {verb}: {job['reason'] or 'the job is done'}; {text}{place}", file=sys.stderr)
    return int(job["exit_status"]) if confirmed else NotConfirmedOff.exit_status


def _output_now(client: Client, events: Any) -> tuple[str, bool]:
    """Return a text about the output after the job, and True unless it is not confirmed off.

    If another job has begun since, the output is that job's affair: the end of this one was confirmed, or its status
    says that it was not. The last state among the events counts if the daemon has ended since.
    """
    state: dict[str, Any] | None
    try:
        state = _state(client)
    except NoDaemon as error:
        state = None
        with suppress(NoDaemon):
            state = next((message["data"] for message in events if message["event"] == "state"), None)
        if state is None:
            return f"OUTPUT NOT CONFIRMED OFF: {error}", False
    if state.get("job") is None and not state.get("output_confirmed"):
        return "OUTPUT NOT CONFIRMED OFF: see `peltier status`", False
    if state.get("output") != "off":
        return f"the output is {state.get('output')}, for the bench's present work: see `peltier status`", True
    return f"output off, {off_in_words(state)}", True


def _state(client: Client) -> dict[str, Any]:
    """Return the bench's state; nothing, which confirms nothing, if the daemon refuses. Raises NoDaemon."""
    try:
        state: dict[str, Any] = client.ask("GET", "/api/state")
    except Refusal:
        return {}
    return state


def _until_it_ends(events: Any, job: dict[str, Any], stream: Any, progress: _Progress) -> dict[str, Any]:
    """Print the job's messages and progress; return the job as it ended. Raises NoDaemon."""
    line, running, state_s, shown = TerminalLine(sys.stderr), None, 0.0, ""

    def show(text: str) -> None:
        line.clear()
        print(text, file=stream, flush=True)

    try:
        for message in events:
            event, data = message["event"], message["data"]
            progress.take(event, data, job["id"])
            if event == "state":
                mine = data["job"] is not None and data["job"]["id"] == job["id"]
                running = {**data["job"], "drive_unit": data["drive_unit"]} if mine else None
                state_s = data["time_s"]
                why = _held_by(data) if data["job"] is None else None
                if why is not None and why != shown:
                    shown = why
                    show(why)
            elif event == "say" and data["id"] == job["id"]:
                show(data["text"])
            elif event == "row" and running is not None and data.get("job") == job["id"] and line.due():
                line.show(progress_line(data, running, state_s))
            elif event == "job" and data["id"] == job["id"] and data["ended_s"] is not None:
                ended: dict[str, Any] = data
                return ended
    finally:
        line.clear()
    raise NoDaemon("the daemon is silent")


def _held_by(state: dict[str, Any]) -> str | None:
    """Return why no job runs; None if one may start."""
    latch = state.get("trip") or state.get("stop")
    if latch:
        clear = "once the cause is removed, `peltier reset --reason TEXT` lets it begin"
        return f"the bench is {state['state']} ({latch['text']}): the job waits; {clear}"
    if state["state"] in HOLDING:
        return f"the bench is {state['state']}: the job waits (`peltier status` says why)"
    return f"the job waits: {state['no_job_because'][0]}" if state["no_job_because"] else None


def _ended_by(verb: str, client: Client, number: str, signal_number: int) -> int:
    """End the job; return 128 + n if it never began, or if the output is confirmed off. Raises NoDaemon."""
    name = signal.Signals(signal_number).name
    try:
        job = client.ask("DELETE", f"/api/jobs/{number}", by=name)
        state = job["bench"]
    except Refusal:  # there is no such job any more
        job, state = {}, _state(client)
    if job.get("state") == "stopped" and job.get("started_s") is None:  # it still waited
        print(f"peltier {verb}: taken out of the queue by {name}: the job had not begun", file=sys.stderr)
        return 128 + signal_number
    another = state.get("job") is not None and state["job"]["id"] != number
    if state.get("output") != "off" and not another:  # if this one's end was not confirmed no other begins
        return _not_confirmed(verb, "see `peltier status`")
    off = f"output off, {off_in_words(state)}" if not another else "its output was off before the next job began"
    print(f"peltier {verb}: stopped by {name}; {off}", file=sys.stderr)
    return 128 + signal_number
