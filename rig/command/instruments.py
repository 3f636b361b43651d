"""Verbs of the instruments: ports, check, emulate."""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.command.record_arguments import add_json_argument
from rig.command.terminal import Terminal
from rig.core.faults import fault
from rig.core.requirements import require

if TYPE_CHECKING:
    from rig.bench.assembly import Bench
    from rig.config.configuration import ConfigurationFile
    from rig.drivers.registry import Tried


def ports_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("ports", nargs="*", metavar="PORT", help="these only, such as /dev/ttyUSB0 or socket://host:1")
    parser.add_argument("--ask", action="store_true", help="ask who answers")
    add_json_argument(parser)


def ports(options: argparse.Namespace) -> int:
    """peltier ports: the serial ports that are there, what is attached, and whether another process holds them.

    peltier ports                          what the computer knows of each port, and who holds it; nothing is sent
    peltier ports --ask [PORT ...]         and which of the instruments answers there: a harmless question in each
                                           protocol, at each one's factory line settings, until one is answered; at a
                                           silent port that takes half a minute, and each question is shown
    """
    from serial.tools.list_ports import comports

    from rig.ports.open import holder

    terminal = Terminal(options.json)
    known = {port.device: port for port in sorted(comports())}
    found = []
    for name in options.ports or known:
        port = known.get(name)
        process, command = holder(name)
        held = f"held by process {process} {command}".strip() if process is not None else "free"
        entry: dict[str, Any] = {
            "port": name,
            "description": port.description if port is not None else None,
            "serial_number": port.serial_number if port is not None else None,
            "held_by": process,
        }
        text = f"{port.description}  {port.serial_number or ''}" if port is not None else "not listed"
        terminal.print(f"{name:<20} {text}  {held}")
        if options.ask and process is None:
            entry |= _asked(name, terminal)
        found.append(entry)
    if not found:
        terminal.print("no serial port is there (a pseudo-terminal or socket:// is not listed)")
    terminal.write_json({"format": "peltier-ports/1", "ports": found})
    return 0


def _asked(port: str, terminal: Terminal) -> dict[str, Any]:
    """Ask who answers at a port, by the driver that understands it."""
    from rig.core.clock import RealClock
    from rig.core.errors import RigError
    from rig.core.streams import TerminalLine
    from rig.drivers.registry import tries

    line = TerminalLine(sys.stderr)
    came: dict[str, list[str]] = {}
    try:
        for tried in tries(port, RealClock(), lambda text: line.show(f"{'':<20} {text}")):
            line.clear()
            if tried.identity is not None:
                terminal.print(f'{"":<20} {tried.identity}: driver = "{tried.driver}"')
                return {"driver": tried.driver, "instrument": str(tried.identity)}
            if tried.came is not None:
                came.setdefault(tried.came, []).append(tried.driver)
    except RigError as error:
        line.clear()
        terminal.print(f"{'':<20} {error}")
        return {"driver": None, "error": str(error)}
    for text, drivers in came.items():
        terminal.print(f"{'':<20} {text}, asked as {', '.join(dict.fromkeys(drivers))}")
    said = "somebody answers, and is not understood" if came else "nobody answers"
    terminal.print(f"{'':<20} {said} (other line settings? see docs/instruments.md)")
    return {"driver": None, **({"came": list(came)} if came else {})}


STOPS = 11  # times that switching off is measured


def check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    parser.add_argument("--clear", action="store_true", help="clear an error that the controller reports")
    add_json_argument(parser)


def check(options: argparse.Namespace) -> int:
    """peltier check CONFIG: compare the instruments with the configuration, and measure how soon the output can be off.

    The output is commanded off first and last; no current flows. Limits and dead man are set and read back. The time is
    the median of several off commands, each confirmed by the controller. Exit status 1 if something is not as
    configured, or if another program has a port open, too.

    An error that the controller reports is printed with its meaning and what clears it. On a terminal the program asks
    whether to clear it; --clear clears it without asking.
    """
    from rig.config.configuration import read_configuration

    terminal = Terminal(options.json)
    file = read_configuration(options.config, for_experiment=False)
    from rig.bench.assembly import open_bench
    from rig.safety.signals import SignalStop
    from rig.safety.switching_off import off_confirmed

    with SignalStop() as signals, _who_answers_instead(file), open_bench(file, only_look=True) as bench:
        signals.look()
        faults = [*_identities(file, bench, terminal), *_not_alone(file)]
        result: dict[str, Any] = {
            "format": "peltier-check/1",
            "instruments": {role: str(identity) for role, identity in bench.identities.items()},
            "temperature_degC": _temperature(bench, file.content.limits.temperature_degC, terminal, faults),
            "status": _status(bench, terminal, faults, options.clear),
            **_limits(file, bench, terminal, faults),
            **_film(bench, terminal, faults),
            **_stop(bench, terminal),
        }
    for line in faults:
        terminal.print(f"NOT AS CONFIGURED: {line}")
    terminal.print(off_confirmed(bench.controller))
    terminal.write_json({**result, "faults": faults})
    return 1 if faults else 0


@contextmanager
def _who_answers_instead(file: ConfigurationFile) -> Iterator[None]:
    """Ask who answers if an instrument does not answer at its port: ports may be swapped, or a driver be another's.

    Raises Faults for that, with the output off, confirmed, by a controller that answers at the ohmmeter's port;
    otherwise NotConfirmedOff, or the InstrumentError that it was.
    """
    from rig.core.errors import Corrupt, OutOfStep, TimedOut
    from rig.core.faults import Faults
    from rig.core.outcome import NotConfirmedOff

    try:
        yield
    except (NotConfirmedOff, TimedOut, Corrupt, OutOfStep) as error:
        if isinstance(error, NotConfirmedOff):  # whoever reads this may have to switch off by hand, at once
            text = f"OUTPUT NOT CONFIRMED OFF: {error}. Asking who answers at the ports ..."
            print(text, file=sys.stderr, flush=True)
        try:
            lines, off = _others(file)
        except BaseException as other:  # a signal, a port that is held: the output is not confirmed off all the same
            if isinstance(error, NotConfirmedOff):
                raise error from other
            raise
        if not lines:
            raise
        if isinstance(error, NotConfirmedOff) and not off:
            raise NotConfirmedOff("; ".join([*lines, str(error)])) from error
        raise Faults(lines) from error


def _others(file: ConfigurationFile) -> tuple[list[str], bool]:
    """Return a line for each port at which another instrument answers than expected, and True if the ports are swapped
    and the controller, at the ohmmeter's port, confirmed its output off."""
    from rig.core.clock import RealClock
    from rig.drivers.registry import open_controller
    from rig.safety.switching_off import off_confirmed, switch_off

    controller, meter = file.content.bench.controller, file.content.bench.meter
    tables = {"controller": controller} | ({"meter": meter} if meter is not None else {})
    drivers = [table.driver for table in tables.values()]
    found = {} if file.content.simulated else {role: _who(table.port, drivers) for role, table in tables.items()}
    lines = [
        f"{file.path}: bench.{role}.port: {tables[role].port!r}: expected the {role} ({tables[role].driver}); "
        f"there answers {who.identity} (driver {who.driver!r})"
        for role, who in found.items()
        if who is not None and who.driver != tables[role].driver
    ]
    here, there = found.get("controller"), found.get("meter")
    if meter is None or here is None or there is None or [there.driver, here.driver] != drivers:
        return lines, False
    lines.append(f"{file.path}: bench.controller.port, bench.meter.port: they are swapped; exchange them")
    swapped = open_controller(controller.driver, meter.port, RealClock(), **controller.options)
    off = switch_off(swapped).confirmed
    swapped.close()
    lines[-1] += f". {off_confirmed(swapped)}" if off else ""
    return lines, off


def _who(port: str, first: list[str]) -> Tried | None:
    """Return who answers at a port, likely drivers asked first; None if nobody does."""
    from rig.core.clock import RealClock
    from rig.core.errors import Disconnected
    from rig.core.streams import TerminalLine
    from rig.drivers.registry import tries

    line = TerminalLine(sys.stderr)
    with suppress(Disconnected):
        for tried in tries(port, RealClock(), lambda text: line.show(f"{port}: {text}"), first):
            line.clear()
            if tried.identity is not None:
                return tried
    return None


def _identities(file: ConfigurationFile, bench: Bench, terminal: Terminal) -> list[str]:
    """Print the identities; return a line for each that differs from the configuration."""
    for role, identity in bench.identities.items():
        terminal.print(f"{role}: {identity}")
    return file.strangers(bench.identities)


def _not_alone(file: ConfigurationFile) -> list[str]:
    """Return a line for each other program that has one of the ports open as well, whose output nobody here switches
    off."""
    from rig.ports.open import open_elsewhere

    ports = [part.port for part in (file.content.bench.controller, file.content.bench.meter) if part is not None]
    text = "it can command the instrument, and take answers to this program: end it"
    return [
        f"{port}: process {process} ({command}) has it open as well; {text}"
        for port in ports
        for process, command in open_elsewhere(port)
    ]


def _temperature(bench: Bench, limits: tuple[float, float], terminal: Terminal, faults: list[str]) -> float:
    temperature = bench.controller.read_temperature()
    terminal.print(f"temperature: {temperature.value:.3f} degC ({temperature.quality})")
    low, high = limits
    if temperature.is_number and not low <= temperature.value <= high:
        faults.append(f"limits.temperature_degC: [{low:g}, {high:g}]: the temperature is outside, and trips each run")
    if not temperature.is_number:
        faults.append(f"the thermometer's reading is {temperature.quality}")
    return temperature.value


def _status(bench: Bench, terminal: Terminal, faults: list[str], clear: bool) -> dict[str, Any]:
    """Print the controller's status; clear an error if the user wants that."""
    from rig.core.errors import InstrumentError

    status = bench.controller.status()
    terminal.print(f"status: {status.text}")
    if status.is_error and status.remedy:
        terminal.print(f"what to do: {status.remedy}")
    if status.is_error and (clear or _wanted()):
        try:
            bench.controller.clear_error()
            status = bench.controller.status()
            terminal.print(f"cleared; status: {status.text}")
        except InstrumentError as error:
            terminal.print(f"not cleared: {error}")
    if status.is_error:
        faults.append(f"the controller reports: {status.text}")
    return {"text": status.text, "is_error": status.is_error, "code": status.code, "remedy": status.remedy}


def _wanted() -> bool:
    """Return True if the user, asked on a terminal, wants the error cleared; elsewhere nobody is asked."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print("Clear the error? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _limits(file: ConfigurationFile, bench: Bench, terminal: Terminal, faults: list[str]) -> dict[str, Any]:
    """Read the instrument's own limits and dead man back."""
    from rig.drivers.controller import drive_unit

    limits, controller = file.content.limits, bench.controller
    own = controller.own_limits()
    dead_man_s = file.content.bench.controller.dead_man_s
    faults += own.faults(limits.current_A, limits.temperature_degC, dead_man_s)
    current_A, low_degC, high_degC = (
        None if math.isnan(value) else value for value in (own.current_A, own.low_degC, own.high_degC)
    )
    unit = drive_unit(controller)
    no_limit = f"no {'current' if unit == 'A' else 'drive'} limit of its own"
    current = no_limit if current_A is None else f"{current_A:g} {unit}"
    dead_man = f"{own.dead_man_s:g} s" if controller.has_dead_man else "none: it has none"
    terminal.print(f"limits read back: {current}, {_span(low_degC, high_degC)}; dead man {dead_man}")
    return {
        "own_limits": {
            "current_A": current_A,
            "temperature_degC": None if low_degC is None and high_degC is None else [low_degC, high_degC],
            "dead_man_s": own.dead_man_s if controller.has_dead_man else None,
        },
        "dead_man": controller.has_dead_man,
    }


def _span(low_degC: float | None, high_degC: float | None) -> str:
    """Return temperature limits in words; None if the instrument has no such limit."""
    if low_degC is None:
        if high_degC is None:
            return "no temperature limits of its own"
        return f"up to {high_degC:g} degC (no lower temperature limit of its own)"
    if high_degC is None:
        return f"from {low_degC:g} degC (no upper temperature limit of its own)"
    return f"{low_degC:g} to {high_degC:g} degC"


def _film(bench: Bench, terminal: Terminal, faults: list[str]) -> dict[str, Any]:
    from rig.drivers.meter import column_of, reading_in_words, settled_reading

    if bench.meter is None:
        return {"resistance_ohm": None}
    reading = settled_reading(bench.meter)
    column = column_of(bench.meter.output)
    name, _, unit = column.partition("_")
    terminal.print(
        f"{name}: {reading.value:.6g} {unit} ({reading.quality}), range {bench.meter.full_scale:g}, "
        f"test current {bench.meter.test_current_A:g} A"
    )
    if wrong := reading_in_words(reading, bench.meter):
        faults.append(wrong)
    return {
        column: reading.value if reading.is_number else None,
        "quality": str(reading.quality),
        "full_scale": bench.meter.full_scale,
        "test_current_A": bench.meter.test_current_A,
    }


def _stop(bench: Bench, terminal: Terminal) -> dict[str, Any]:
    """Measure how long an off command takes until the controller has confirmed it, on the bench's own clock."""
    seconds, confirmed = [], True
    for _ in range(STOPS):
        begin_s = bench.clock.now_s()
        confirmed = bench.controller.off() and confirmed
        seconds.append(bench.clock.now_s() - begin_s)
    middle, longest = statistics.median(seconds), max(seconds)
    where = " (simulated time)" if bench.virtual else ""
    terminal.print(
        f"switching off takes {1e3 * middle:.1f} ms (median of {STOPS}), {1e3 * longest:.1f} ms at most, "
        f"until the controller has confirmed it{where}"
    )
    return {"stop_s": middle, "stop_longest_s": longest, "output_off_confirmed": confirmed}


LOOK_S = 0.2  # between looks at the output: a line on stderr need not come sooner
SILENT_S = 5.0  # with the output on, after which a program has ended or hangs: those that steer speak once a second
FASTEST = 1e4  # times real time: beyond it, no computer keeps up with the simulated plant


def emulate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="times real time (1)")


def emulate(options: argparse.Namespace) -> int:
    """peltier emulate CONFIG [--speed X]: the simulated instruments on pseudo-terminals, until stopped.

    Prints a line an instrument, `controller meerstetter /dev/pts/3`, and nothing else on stdout; then serves in real
    time (times X). The instruments share one plant. On stderr it says what a heater would not: that a program has left
    the output on, or that the controller has switched it off by itself; and at the end whether it is off.
    """
    from rig.config.configuration import read_configuration

    require("emulate")
    if not 1e-6 <= options.speed <= FASTEST:
        raise fault("--speed", repr(options.speed), f"expected a number from 1e-6 to {FASTEST:g}")
    file = read_configuration(options.config, for_experiment=False)
    from rig.bench.assembly import emulated_instruments, simulated_world
    from rig.ports.pseudo_terminal import PseudoTerminals
    from rig.safety.signals import SignalStop
    from sim.world.plant import SimulatedPlant

    first = SimulatedPlant(simulated_world(file), 0.0)  # its loops are compiled before anybody can ask: whoever asked
    first.advance_to(1.0)  # meanwhile would have no answer in time
    if file.content.bench.meter is not None:
        first.read_resistance_ohm(1e-4)
    plant = SimulatedPlant(simulated_world(file), 0.0)
    instruments = emulated_instruments(file, 0.0, plant)
    with SignalStop(), PseudoTerminals({role: i for role, _, i in instruments}, speed=options.speed) as terminals:
        for role, name, _ in instruments:
            print(f"{role} {name} {terminals.paths[role]}", flush=True)
        output = Output()
        try:
            while terminals.failure is None:
                time.sleep(LOOK_S)
                for line in output.seen(plant.current_A, terminals.heard_s.get("controller", 0.0), time.monotonic()):
                    print(line, file=sys.stderr, flush=True)
            raise terminals.failure
        finally:
            print(f"controller: at the end {in_words(plant.current_A)}", file=sys.stderr, flush=True)


def in_words(current_A: float) -> str:
    """Return in words if the output is on; a simulated current is what flows, to the last bit."""
    return f"its output is on, {current_A:.3g} A" if current_A != 0.0 else "its output is off"


class Output:
    """Lines on the output as it is seen, LOOK_S after LOOK_S."""

    def __init__(self) -> None:
        self._current_A, self._looked_s, self._said = 0.0, 0.0, False

    def seen(self, current_A: float, heard_s: float, now_s: float) -> list[str]:
        """Return lines, mostly none. heard_s: when the controller was written to last, on the scale of now_s (s)."""
        before_A, looked_s = self._current_A, self._looked_s
        self._current_A, self._looked_s = current_A, now_s
        silent_s = now_s - heard_s
        if before_A != 0.0 and current_A == 0.0 and heard_s < looked_s - LOOK_S:
            self._said = False
            return [f"controller: it has switched its output off by itself, after {silent_s:.1f} s without a command"]
        if silent_s < SILENT_S or current_A == 0.0:
            self._said = False
            return []
        said, self._said = self._said, True
        return [] if said else [f"controller: {in_words(current_A)}, and nobody has spoken to it for {silent_s:.0f} s"]
