"""`peltier serve` put together: the process that holds the ports, its socket, and the web processes."""

from __future__ import annotations

from contextlib import ExitStack, closing, suppress
from pathlib import Path

from rig.bench.assembly import open_bench
from rig.config.configuration import ConfigurationFile
from rig.core.errors import PortHeld, RigError
from rig.core.faults import Faults, fault
from rig.core.outcome import NotConfirmedOff
from rig.core.streams import PatientLines
from rig.daemon.client import socket_to_bind
from rig.daemon.command_queue import CommandQueue
from rig.daemon.configurations import history_folder
from rig.daemon.http_server import Requests, UnixServer
from rig.daemon.nightly import Nightly
from rig.daemon.supervisor import Supervisor
from rig.daemon.systemd import Notifier, SignalStopWithNotice, watchdog_s
from rig.daemon.web_process import WebProcess, stop_listener, why_not
from rig.drivers.registry import controller_class
from rig.guard.pipe import Guard
from rig.history.store import FolderLock

LOG_PATIENCE_S = 1.0  # at the end, for the reader of the log: he must not delay the end
CYCLE_S = 5.0  # of a cycle and the dead man's margin: an instrument that does not answer is asked again for seconds
LOOPBACK = ("127.0.0.1", "::1", "localhost")
TOKEN = "serve.token is set: page and interface require it, on the loopback too"
METRICS = "; /metrics takes serve.metrics_token as well"
REAL_TIME = "bench.time: a daemon runs in real time, whatever the configuration says"


def bench_of(
    file: ConfigurationFile, address: str | None = None, port: int | None = None
) -> tuple[ConfigurationFile, list[str]]:
    """Return the configuration as the daemon uses it, and notes about that. Raises Faults."""
    content = file.content
    changes = {key: value for key, value in (("address", address), ("port", port)) if value is not None}
    serve = content.serve.model_copy(update=changes)
    if not 0 <= serve.port <= 65535:
        raise fault("--port", str(serve.port), "expected 0 to 65535")
    if serve.address not in LOOPBACK and serve.token is None:
        raise fault(file.path, "serve.token", f"missing; address {serve.address} is not the loopback: expected a token")
    _check_watchdog(file)
    notes = [REAL_TIME] if content.bench.time == "virtual" else []
    bench = content.bench.model_copy(update={"time": "real"})
    real = content.model_copy(update={"serve": serve, "bench": bench})
    return ConfigurationFile(file.path.absolute(), file.text, real), notes


def _check_watchdog(file: ConfigurationFile) -> None:
    """Raise Faults if systemd's watchdog would end a daemon that works.

    It completes no cycle between two readings, nor while it is silent for the dead man of a controller that does not
    obey. If it were ended in that silence and started again, it would talk to the controller before the dead man acts.
    """
    longest_s, content = max(watchdog_s() - CYCLE_S, 0.0), file.content
    silences = [("serve.idle_period_s", content.serve.idle_period_s, "it reads only so often")]
    with suppress(ValueError):  # no such driver: reported when it is opened
        if controller_class(content.bench.controller.driver).has_dead_man:
            why = 'it is silent for so long if an "off" is not confirmed'
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
    """Switch the output off before a large history is checked. The supervisor meets other errors again, and reports
    them. Raises PortHeld; and on a signal Stopped, or NotConfirmedOff."""
    with SignalStopWithNotice(notifier, file.content.bench.controller.dead_man_s) as signals:
        try:
            with open_bench(file, guard):
                pass
        except PortHeld:
            raise
        except (RigError, NotConfirmedOff):
            if signals.received is not None:
                raise


def _token_notes(file: ConfigurationFile) -> list[str]:
    table = file.content.serve
    if table.token is None:
        return []
    return [TOKEN + (METRICS if table.metrics_token is not None else "")]


def _web_processes(file: ConfigurationFile, place: Path, commands: CommandQueue, stack: ExitStack) -> list[WebProcess]:
    """Return the page's process and, if it can have a port, that of STOP's own listener."""
    table = file.content.serve
    address = (table.address, table.port)
    pages = [WebProcess(place, commands.note, address)]
    try:
        listener = stack.enter_context(stop_listener(table.address, table.port, table.stop_port))
    except OSError as error:
        commands.note(f"STOP has no listener of its own (serve.stop_port): {why_not(error)}")
        return pages
    commands.stop_port = int(listener.getsockname()[1])
    return [WebProcess(place, commands.note, address, listener), *pages]


def serve(file: ConfigurationFile, notes: list[str], guard: Guard) -> int:
    """Serve the bench until a signal. The socket comes first, so that a second daemon is refused."""
    with ExitStack() as stack:
        log = PatientLines("peltier serve")
        stack.callback(log.close, LOG_PATIENCE_S)
        place = socket_to_bind(file.content.serve.name)
        server = stack.enter_context(closing(UnixServer(place)))
        folder = stack.enter_context(closing(FolderLock(history_folder(file))))
        with suppress(OSError):  # a full disk: the command queue tries again, and reports
            folder.take()
        notifier = stack.enter_context(closing(Notifier()))
        _off_first(file, guard, notifier)
        commands = CommandQueue(file, notes, folder.take, log)
        held = commands.no_job_because()[: 1 if commands.latch is not None else 0]
        for line in [*commands.warnings(), *held, *_token_notes(file)]:
            log(line)
        server.start(Requests(commands))
        for web in _web_processes(file, place, commands, stack):
            stack.callback(web.stop)
            web.start()
        if file.content.serve.diagnose == "nightly":
            nightly = Nightly(commands.folder, file.content.serve.diagnose_hour, commands.is_idle, commands.note)
            stack.callback(nightly.stop)
            nightly.start()
        Supervisor(file, commands, notifier, guard).keep()
    return 0
