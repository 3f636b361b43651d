"""`peltier run` and `calibrate` on ports that a daemon holds: a job of its, which is followed to its end.

    status = handed_over("run", options.config, options.out, options.json, options.bench)
    if status is not None:
        return status

Import-light, so that it can be asked before the bench's own code is loaded. The exit status is the job's: what
the verb would have given. Ctrl-C ends the job as it would end a run; a reader who goes ends nothing.
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
from rig.core.terminal_line import TerminalLine
from rig.daemon.asking import checked, one_daemon, report, teller
from rig.daemon.client import CALIBRATION, Client, NoDaemon, daemons
from rig.daemon.ended_before import LOOK_AGAIN_S, end_of_the_last_run
from rig.daemon.words import in_a_line, off_in_words
from rig.safety.signals import SignalStop

HOLDING = ("tripped", "stopped", "offline")
NEVER_BEGAN = 1  # the exit status of a job that waited when its daemon ended: nothing of it needs to be off
DIED = 1  # that of one whose output the guard has switched off, confirmed, when the daemon's process died
GUARD_S = 40.0  # for what the guard finds: it looks at the temperature for 20 s, after a dead man's silence or two
ENDS_S = 10.0  # for a daemon that tells nothing any more to be gone; its page and its log take a second or two
SILENCE_S = 60.0  # a daemon tells its state every 5 s


@dataclass
class _Course:
    """waited: whether the daemon last said that the job waits, for another one or for the bench, and never that it has
    begun. Where it said neither, the job may have begun since. folder: where the job's rows go, once it has begun."""

    waited: bool = False
    begun: bool = False
    folder: str | None = None

    def take(self, event: str, data: dict[str, Any], number: str) -> None:
        """What was told."""
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
    """--bench NAME, of the verbs whose work a daemon can do."""
    parser.add_argument(
        "--bench", metavar="NAME", help="let this daemon do it (serve.name); needed where its ports are sim://"
    )


def handed_over(
    verb: str, config: Path, out: Path | None, json_target: str | None = None, bench: str | None = None
) -> int | None:
    """The exit status of the job, or None where no daemon holds the configuration's ports. Raises Faults.

    bench: the daemon that shall do it, whatever the ports. sim:// is no port that two could share: by itself, a run
    with such ports has a simulated rig of its own.
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
                who = client.ask("who")
            except NoDaemon:
                continue
            if {os.path.realpath(port) for port in who.get("ports", [])} & ports:
                try:
                    with Client(client.path, SILENCE_S) as stream:
                        return _followed(verb, client, stream, config, out, json_target)
                except NoDaemon as error:
                    raise fault(config, "bench", f"a daemon has its ports, and takes no job: {error}") from None
    return None


def _ports(config: Path) -> set[str]:
    """Real ports that the configuration names; none where it cannot be read: whoever reads it in earnest tells why."""
    try:
        bench = read_toml(config)["bench"]
        ports = [bench[role]["port"] for role in ("controller", "meter") if role in bench]
    except (Faults, KeyError, TypeError):
        return set()
    return {os.path.realpath(port) for port in ports if isinstance(port, str) and not port.startswith("sim://")}


def _followed(verb: str, client: Client, told: Client, config: Path, out: Path | None, json_target: str | None) -> int:
    """`client` answers, `told` tells what happens. From the moment that there may be a job, a signal ends it."""
    stream, course = teller(json_target), _Course()
    events = told.events(SILENCE_S)
    next(events)  # the state: from here on nothing is missed
    more = {"out": str(out.absolute())} if out is not None else {}
    if verb == "calibrate":
        more["kind"] = CALIBRATION
    with SignalStop() as signals:
        signals.shield()  # what comes before the answer waits for it: then there is a job to end
        try:
            job = checked(client.ask("submit", path=str(config.absolute()), **more))["job"]
        except NoDaemon as error:
            return _not_confirmed(verb, f"{error}, which may have begun the job; {_make_sure(config)}")
        try:
            signals.expose()
            print(
                f"handed over to the daemon {client.path.stem}, which holds the ports, as job {job['id']}",
                file=stream,
                flush=True,
            )
            job = _until_it_ends(events, job, stream, course)
        except Stopped as stopped:
            signals.shield()
            try:
                return _ended_by(verb, client, job["id"], stopped.number)
            except NoDaemon as error:
                with SignalStop():  # another one ends the waiting
                    return _without_daemon(verb, client, job["id"], course, error, config)
        except NoDaemon as error:
            return _without_daemon(verb, client, job["id"], course, error, config)
    return _told_of_the_end(verb, client, events, job, json_target)


def _without_daemon(verb: str, client: Client, number: str, course: _Course, error: NoDaemon, config: Path) -> int:
    """The exit status where the daemon tells nothing any more, as far as it can be found."""
    if _stays(client, number, course):
        return _not_confirmed(verb, f"{error} while the job ran; {_make_sure(config)}")
    if not course.waited:
        return _left_to_the_guard(verb, course.folder, f"{error} while the job ran", config)
    text = f"the job never began: {error} while it waited; give it again when the daemon runs again"
    print(f"peltier {verb}: {text}; {_make_sure(config)}", file=sys.stderr)
    return NEVER_BEGAN


def _stays(client: Client, number: str, course: _Course) -> bool:
    """Whether the daemon is still there: what ended may be the connection that told what happens. One that ends answers
    for a moment after that, and begins no job any more."""
    until_s = time.monotonic() + ENDS_S
    with suppress(NoDaemon):
        while time.monotonic() < until_s:
            course.waited = client.ask("follow", id=number).get("job", {}).get("state") == "queued"
            time.sleep(LOOK_AGAIN_S)
        return True
    return False


def _left_to_the_guard(verb: str, folder: str | None, why: str, config: Path) -> int:
    """Of a job whose daemon's process has died: what the guard finds, or where to read it. A signal ends the waiting,
    and confirms nothing."""
    found = None
    if folder is not None:
        print(f"peltier {verb}: {why}; waiting for what its guard writes into {folder}", file=sys.stderr, flush=True)
        with suppress(Stopped):
            found = end_of_the_last_run(folder, GUARD_S)
    if found is None:
        where = f", and in {folder}/run.json" if folder is not None else ""
        return _not_confirmed(verb, f"{why}; what its guard finds is in the daemon's log{where}; {_make_sure(config)}")
    confirmed, text = found
    if not confirmed:
        return _not_confirmed(verb, f"{text}. Switch the controller off by hand.")
    drawn = f"{folder}/report.html, or `peltier report {folder}` draws it"
    print(f"peltier {verb}: {text}; what was recorded is in {folder}; report: {drawn}", file=sys.stderr)
    return DIED


def _make_sure(config: Path) -> str:
    """What to do where no daemon answers any more."""
    return f"`peltier off {config}` switches the output off, if it is not, and confirms it"


def _not_confirmed(verb: str, why: str) -> int:
    print(f"peltier {verb}: OUTPUT NOT CONFIRMED OFF: {why}", file=sys.stderr)
    return NotConfirmedOff.exit_status


def _told_of_the_end(verb: str, client: Client, events: Any, job: dict[str, Any], json_target: str | None) -> int:
    """The job's exit status, or that of an output that nobody confirms to be off, which outranks it."""
    said, confirmed = _output_now(client, events)
    if job["exit_status"] == 0:
        report(json_target, _result(client, job["id"]))
    if job["exit_status"] == 0 and confirmed:
        print(f"{said}\nreport: {job['folder']}/report.html", file=teller(json_target), flush=True)
    else:
        place = f"; what was recorded is in {job['folder']}" if job["folder"] else ""
        place += f"; report: {job['folder']}/report.html" if job.get("report") else ""
        print(f"peltier {verb}: {job['reason'] or 'the job is done'}; {said}{place}", file=sys.stderr)
    return int(job["exit_status"]) if confirmed else NotConfirmedOff.exit_status


def _result(client: Client, number: str) -> dict[str, Any]:
    """What the job found; nothing where the daemon has gone since: its folder has it."""
    try:
        return client.ask("follow", id=number).get("result") or {}
    except NoDaemon:
        return {}


def _output_now(client: Client, events: Any) -> tuple[str, bool]:
    """What the daemon says of the output when a job has ended, and whether it can answer for it.

    The output of a job that has begun since is that job's affair: this one's end was confirmed, or its own status
    says that it was not. events: what a daemon that has ended since has told behind the job's end is its last word.
    """
    try:
        state = client.ask("state").get("state", {})
    except NoDaemon as error:
        state = _told_behind(events)
        if state is None:
            return f"OUTPUT NOT CONFIRMED OFF: {error}", False
    if state.get("job") is None and not state.get("output_confirmed"):
        return "OUTPUT NOT CONFIRMED OFF: see `peltier status`", False
    if state.get("output") != "off":
        return f"the output is {state.get('output')}, for what the bench does now: see `peltier status`", True
    return f"output off, {off_in_words(state)}", True


def _told_behind(events: Any) -> dict[str, Any] | None:
    """The next state that was told; None where none was."""
    with suppress(NoDaemon):
        for message in events:
            if message["event"] == "state":
                state: dict[str, Any] = message["data"]
                return state
    return None


def _until_it_ends(events: Any, job: dict[str, Any], stream: Any, course: _Course) -> dict[str, Any]:
    """What is said meanwhile, and the job as it ended; a line tells how far it is. Raises NoDaemon."""
    line, doing, told_s, held = TerminalLine(sys.stderr), None, 0.0, ""

    def tell(text: str) -> None:
        line.clear()
        print(text, file=stream, flush=True)

    try:
        for message in events:
            event, data = message["event"], message["data"]
            course.take(event, data, job["id"])
            if event == "state":
                mine = data["job"] is not None and data["job"]["id"] == job["id"]
                doing = {**data["job"], "drive_unit": data["drive_unit"]} if mine else None
                told_s = data["time_s"]
                why = _held_by(data) if data["job"] is None else None
                if why is not None and why != held:
                    held = why
                    tell(why)
            elif event == "say" and data["id"] == job["id"]:
                tell(data["text"])
            elif event == "row" and doing is not None and data.get("job") == job["id"] and line.due():
                line.show(in_a_line(data, doing, told_s))
            elif event == "job" and data["id"] == job["id"] and data["ended_s"] is not None:
                ended: dict[str, Any] = data
                return ended
    finally:
        line.clear()
    raise NoDaemon("the daemon is silent")


def _held_by(state: dict[str, Any]) -> str | None:
    """Why no job runs; None where one may start."""
    latch = state.get("trip") or state.get("stop")
    if latch:
        cleared = "once that is seen to, `peltier reset --reason TEXT` lets it begin"
        return f"the bench is {state['state']} ({latch['text']}): the job waits; {cleared}"
    if state["state"] in HOLDING:
        return f"the bench is {state['state']}: the job waits (`peltier status` says why)"
    return f"the job waits: {state['no_job_because'][0]}" if state["no_job_because"] else None


def _ended_by(verb: str, client: Client, number: str, signal_number: int) -> int:
    """End the job; 128 + n where it never began, or the output is off, confirmed. Raises NoDaemon."""
    name = signal.Signals(signal_number).name
    answer = client.ask("cancel", id=number, by=name)
    job, state = answer.get("job") or {}, answer.get("state")
    if state is None:  # there was no such job any more
        state = client.ask("state").get("state", {})
    if job.get("state") == "stopped" and job.get("started_s") is None:  # it still waited
        print(f"peltier {verb}: taken out of the queue by {name}: the job had not begun", file=sys.stderr)
        return 128 + signal_number
    another = state.get("job") is not None and state["job"]["id"] != number
    if state.get("output") != "off" and not another:  # where this one's end was not confirmed no other begins
        return _not_confirmed(verb, "see `peltier status`")
    off = f"output off, {off_in_words(state)}" if not another else "its output was off before the next job began"
    print(f"peltier {verb}: stopped by {name}; {off}", file=sys.stderr)
    return 128 + signal_number
