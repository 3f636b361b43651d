"""`peltier serve` put together: the bench process, its socket, and the web processes."""

from __future__ import annotations

from contextlib import ExitStack, closing, suppress
from pathlib import Path

from rig.bench.assembly import open_bench
from rig.config.configuration import ConfigurationFile
from rig.core.clock import RealClock
from rig.core.errors import PortHeld, RigError
from rig.core.faults import Faults, fault
from rig.core.outcome import NotConfirmedOff
from rig.core.patient_lines import PatientLines
from rig.daemon.answers import Answers
from rig.daemon.bench_state import no_job_because, warnings
from rig.daemon.configured_paths import history_folder
from rig.daemon.control_socket import ControlSocket
from rig.daemon.desk import Desk
from rig.daemon.keeper import Keeper
from rig.daemon.listening import stop_listener, why_not
from rig.daemon.nightly import Nightly
from rig.daemon.places import socket_to_make
from rig.daemon.systemd import EndTold, Notifier, watchdog_s
from rig.daemon.web_process import WebProcess
from rig.drivers.registry import controller_class
from rig.guard.line import Guard
from rig.history.alone import Alone

LOG_PATIENCE_S = 1.0  # at the end, for whoever reads the log: a daemon that is to end is not held up
CYCLE_S = 5.0  # of a cycle and the dead man's margin: an instrument that does not answer is asked again for seconds
LOOPBACK = ("127.0.0.1", "::1", "localhost")
TOKEN = "serve.token is set: the page and its interface ask for it, on the loopback too"
METRICS = "; /metrics takes serve.metrics_token as well"
REAL_TIME = "bench.time: a daemon lives in real time, whatever the configuration says"


def bench_of(
    file: ConfigurationFile, address: str | None = None, port: int | None = None
) -> tuple[ConfigurationFile, list[str]]:
    """The configuration as the daemon takes it, and what people should know of that. Raises Faults."""
    content = file.content
    changes = {key: value for key, value in (("address", address), ("port", port)) if value is not None}
    serve = content.serve.model_copy(update=changes)
    if not 0 <= serve.port <= 65535:
        raise fault("--port", str(serve.port), "expected 0 to 65535")
    if serve.address not in LOOPBACK and serve.token is None:
        raise fault(file.path, "serve.token", f"missing; address {serve.address} is not the loopback: expected a token")
    _require_patient_systemd(file)
    notes = [REAL_TIME] if content.bench.time == "virtual" else []
    bench = content.bench.model_copy(update={"time": "real"})
    real = content.model_copy(update={"serve": serve, "bench": bench})
    return ConfigurationFile(file.path.absolute(), file.text, real), notes


def _require_patient_systemd(file: ConfigurationFile) -> None:
    """Raises Faults where the watchdog would end a daemon that does what it should: it completes no cycle between two
    readings, nor while it is silent so that the dead man of a controller which does not obey acts. Ended in that
    silence, and begun again, it would speak to the controller each time before the dead man has acted."""
    longest_s, content = max(watchdog_s() - CYCLE_S, 0.0), file.content
    silences = [("serve.idle_period_s", content.serve.idle_period_s, "it reads only so often")]
    with suppress(ValueError):  # no such driver: told where it is opened
        if controller_class(content.bench.controller.driver).has_dead_man:
            why = 'it is silent for so long where an "off" is not confirmed'
            silences.append(("bench.controller.dead_man_s", content.bench.controller.dead_man_s, why))
    faults = [
        f"{file.path}: {key}: {silent_s:g}: expected at most {longest_s:g}, {CYCLE_S:g} s below systemd's "
        f"WatchdogSec: {why}, and would be ended for that"
        for key, silent_s, why in silences
        if silent_s > longest_s
    ]
    if faults:
        raise Faults(faults)


def _off_first(file: ConfigurationFile, guard: Guard, notifier: Notifier) -> None:
    """The output off before a large history is checked. What goes wrong here the keeper meets again, and tells.

    Raises PortHeld; and on a signal Stopped, or NotConfirmedOff.
    """
    with EndTold(notifier, file.content.bench.controller.dead_man_s) as signals:
        try:
            with open_bench(file, guard):
                pass
        except PortHeld:
            raise
        except (RigError, NotConfirmedOff):
            if signals.received is not None:
                raise


def _told_of_tokens(file: ConfigurationFile) -> list[str]:
    """Who has to bring a token, for the first lines of `serve`; not the tokens."""
    table = file.content.serve
    if table.token is None:
        return []
    return [TOKEN + (METRICS if table.metrics_token is not None else "")]


def _web_processes(file: ConfigurationFile, place: Path, desk: Desk, stack: ExitStack) -> list[WebProcess]:
    """The page's process, and the one of STOP's own listener, where there is room for that."""
    table = file.content.serve
    door = (table.address, table.port)
    pages = [WebProcess(place, desk.note, door)]
    try:
        listener = stack.enter_context(stop_listener(table.address, table.port, table.stop_port))
    except OSError as error:
        desk.note(f"STOP has no listener of its own (serve.stop_port): {why_not(error)}")
        return pages
    desk.stop_port = int(listener.getsockname()[1])
    return [WebProcess(place, desk.note, door, listener), *pages]


def serve(file: ConfigurationFile, notes: list[str], guard: Guard) -> int:
    """The bench process: socket first, so that a second daemon is told; then the ports and the page. Until a signal."""
    with ExitStack() as stack:
        log = PatientLines("peltier serve")
        stack.callback(log.close, LOG_PATIENCE_S)
        place = socket_to_make(file.content.serve.name)
        listener = stack.enter_context(closing(ControlSocket(place)))
        folder = stack.enter_context(closing(Alone(history_folder(file))))
        with suppress(OSError):  # a full disk: the desk tries again, and tells
            folder.take()
        notifier = stack.enter_context(closing(Notifier()))
        _off_first(file, guard, notifier)
        desk = Desk(file, RealClock(), notes, folder.take, log)
        held = no_job_because(desk)[: 1 if desk.latch is not None else 0]
        for line in [*warnings(desk), *held, *_told_of_tokens(file)]:
            log(line)
        listener.start(Answers(desk))
        for web in _web_processes(file, place, desk, stack):
            stack.callback(web.stop)
            web.start()
        if file.content.serve.diagnose == "nightly":
            nightly = Nightly(desk.folder, file.content.serve.diagnose_hour, desk.is_idle, desk.note)
            stack.callback(nightly.stop)
            nightly.start()
        Keeper(file, desk, notifier, guard).keep()
    return 0
