"""The bench put together: the only place that chooses between real and simulated instruments."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from rig.bench.output_off import OutputOff
from rig.bench.simulation import simulated_world
from rig.config.configuration import ConfigurationFile
from rig.config.tables import ControllerTable, MeterTable
from rig.core.clock import Clock, RealClock, VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, PortHeld, TimedOut, called, of_whom
from rig.core.faults import Faults, fault
from rig.drivers.controller import TemperatureController
from rig.drivers.identity import Identity
from rig.drivers.meter import ResistanceMeter
from rig.drivers.registry import check_options, controller_class, meter_class, open_controller, open_meter
from rig.guard.pipe import UNGUARDED, Guard
from rig.ports.open import open_elsewhere
from rig.ports.protocol_sim import register, unregister
from rig.ports.transport import nobody_answers
from sim.instruments.instrument import Instrument
from sim.instruments.registry import CONTROLLERS, METERS, emulated_controller, emulated_meter, emulator_options
from sim.world.plant import SimulatedPlant

T = TypeVar("T")
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Bench:
    """A controller, a meter where there is one, and the clock that both live by.

    watched_after: somebody goes on reading the instruments when a run on it has ended. called: controller and meter, as
    messages call them.
    """

    controller: TemperatureController
    meter: ResistanceMeter | None
    clock: Clock
    virtual: bool
    identities: dict[str, Identity]
    guard: Guard = UNGUARDED
    watched_after: bool = False
    called: Mapping[str, str] = field(default_factory=dict)


@contextmanager
def open_bench(file: ConfigurationFile, guard: Guard = UNGUARDED, *, only_look: bool = False) -> Iterator[Bench]:
    """Open the ports, identify the instruments, set their limits; the output is commanded off first.

    only_look: take another instrument of the kind as well, and a port that another program has open without a lock;
    otherwise these are a Fault and PortHeld, the latter before anything is sent.
    guard: told what is held before it is opened, and that it was let go of when the output is off and confirmed.
    Raises RigError (PortHeld, TimedOut, Refused, ...), Faults, and NotConfirmedOff where the output cannot be
    switched off. At the end the output is commanded off once more, and the ports are closed.
    """
    c = file.content
    clock: Clock = VirtualClock() if c.virtual_time else RealClock()
    with ExitStack() as stack:
        ports = [c.bench.controller.port, c.bench.meter.port if c.bench.meter else ""]
        if c.simulated:
            ports = _simulated(file, clock, stack)
        elif not any("://" in port for port in ports) and os.path.realpath(ports[0]) == os.path.realpath(ports[1]):
            raise fault(file.path, "bench.meter.port", f"{ports[1]!r} is bench.controller.port too; expected another")
        if not only_look:
            _require_alone(ports)
        controller = _opened(open_controller, file, "controller", c.bench.controller, ports[0], clock, guard)
        stack.callback(controller.close)
        stack.enter_context(OutputOff(controller, c.bench.controller, guard))
        with _told_where(controller, "controller", c.bench.controller):
            identities = {"controller": controller.identify()}
        _require_ours(file, identities, only_look)
        try:
            with _told_where(controller, "controller", c.bench.controller):
                controller.configure(c.limits.current_A, c.limits.temperature_degC, c.bench.controller.dead_man_s)
        except ValueError as error:
            raise fault(file.path, "limits, bench.controller", str(error)) from None
        meter = None
        if c.bench.meter is not None:
            meter = _opened(open_meter, file, "meter", c.bench.meter, ports[1], clock, guard)
            stack.callback(meter.close)
            with _told_where(meter, "meter", c.bench.meter):
                identities["meter"] = meter.identify()
            _require_ours(file, identities, only_look)
            try:
                with _told_where(meter, "meter", c.bench.meter):
                    meter.configure(c.bench.meter.four_wire, c.bench.meter.nplc, c.limits.meter_current_A)
            except ValueError as error:
                raise fault(file.path, "bench.meter, limits.meter_current_A", str(error)) from None
        names = {"controller": _called(controller, "controller", c.bench.controller)}
        if c.bench.meter is not None:
            names["meter"] = _called(meter, "meter", c.bench.meter)
        yield Bench(controller, meter, clock, c.virtual_time, identities, guard, called=names)


@contextmanager
def _told_where(instrument: Any, role: str, table: ControllerTable | MeterTable) -> Iterator[None]:
    """Add the port to the error of an instrument that does not answer at the start."""
    try:
        yield
    except InstrumentError as error:
        silent = nobody_answers(instrument, table.port, role, table.driver, "who it is")
        if silent and isinstance(error, TimedOut | Corrupt | OutOfStep):
            raise type(error)(silent) from error
        of_whom(error, _called(instrument, role, table))
        raise


def _called(instrument: Any, role: str, table: ControllerTable | MeterTable) -> str:
    """Return the name that its own messages give an instrument, or one of role, driver and port."""
    who: str = getattr(getattr(instrument, "transport", None), "who", "")
    return who or called(table.port, role, table.driver)


def _require_ours(file: ConfigurationFile, identities: Mapping[str, Identity], only_look: bool) -> None:
    lines = [] if only_look else file.strangers(identities)
    if lines:
        raise Faults(lines)


def _require_alone(ports: list[str]) -> None:
    """Raise PortHeld if another program has a port open, one that takes no lock included: it could command what we
    switch off, and take the answers to us."""
    for port in ports:
        for process, command in open_elsewhere(port):
            raise PortHeld(port, process, command)


def _opened(
    opener: Callable[..., T],
    file: ConfigurationFile,
    role: str,
    table: ControllerTable | MeterTable,
    port: str,
    clock: Clock,
    guard: Guard,
) -> T:
    """The instrument with the configuration's options. Raises Faults for an option that its driver does not have."""
    options: dict[str, Any] = dict(table.options)
    if table.baud is not None:
        options["baud"] = table.baud
    dead_man_s = getattr(table, "dead_man_s", 0.0)  # a meter has none
    guard.holds(role, table.driver, port, options, dead_man_s)
    try:
        return opener(table.driver, port, clock, **options)
    except ValueError as error:
        _not_ours(role, guard)
        raise fault(file.path, f"bench.{role}.options", str(error)) from None
    except BaseException:
        _not_ours(role, guard)
        raise


def _not_ours(role: str, guard: Guard) -> None:
    """Tell the guard that the controller's port was not opened here: its output is somebody else's business, or what it
    was before."""
    if role == "controller":
        guard.not_opened()


def emulated_instruments(
    file: ConfigurationFile, start_s: float, plant: SimulatedPlant | None = None
) -> list[tuple[str, str, Instrument]]:
    """Return (role, driver's name, emulator) of the configured instruments; they share one plant, by default the file's
    own. Raises Faults."""
    c = file.content
    roles: list[tuple[str, ControllerTable | MeterTable]] = [("controller", c.bench.controller)]
    if c.bench.meter is not None:
        roles.append(("meter", c.bench.meter))
    for role, table in roles:
        known = CONTROLLERS if role == "controller" else METERS
        if table.driver not in known:
            expected = f"{table.driver!r} has no emulator; there are {', '.join(known)}"
            raise fault(file.path, f"bench.{role}.driver", expected)
        driver = controller_class(table.driver) if role == "controller" else meter_class(table.driver)
        try:
            check_options(role, table.driver, driver, table.options)
        except ValueError as error:
            raise fault(file.path, f"bench.{role}.options", str(error)) from None
    plant = SimulatedPlant(simulated_world(file), start_s) if plant is None else plant
    make = {"controller": emulated_controller, "meter": emulated_meter}
    return [(role, t.driver, make[role](t.driver, plant, start_s, **_shared(role, t))) for role, t in roles]


def _shared(role: str, table: ControllerTable | MeterTable) -> dict[str, Any]:
    """Return the driver's options that its emulator has too, such as a model or an address."""
    known = emulator_options(role, table.driver)
    return {name: value for name, value in table.options.items() if name in known}


def _simulated(file: ConfigurationFile, clock: Clock, stack: ExitStack) -> list[str]:
    """Register the emulated instruments with the clock; return their addresses."""
    addresses = []
    for role, _, instrument in emulated_instruments(file, clock.now_s()):
        name = f"{role}-{next(_numbers)}"
        addresses.append(register(name, instrument, clock))
        stack.callback(unregister, name)
    return [*addresses, ""]
