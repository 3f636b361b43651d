"""The bench put together: the only place that chooses between real and simulated instruments."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from rig.clock import Clock, RealClock, VirtualClock
from rig.drivers.controller import TemperatureController
from rig.drivers.identity import Identity
from rig.drivers.meter import ResistanceMeter
from rig.drivers.registry import open_controller, open_meter
from rig.faults import fault
from rig.files.configuration import ConfigurationFile
from rig.outcome import NotConfirmedOff
from rig.ports.registry import register, unregister
from rig.simulation import simulated_world
from sim.instruments.instrument import Instrument
from sim.instruments.registry import CONTROLLERS, METERS, emulated_controller, emulated_meter
from sim.plant import SimulatedPlant

OFF_CONFIRMED = "output off, confirmed by the controller"
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Bench:
    """A controller, a meter where there is one, and the clock that both live by."""

    controller: TemperatureController
    meter: ResistanceMeter | None
    clock: Clock
    virtual: bool
    identities: dict[str, Identity]


@contextmanager
def open_bench(file: ConfigurationFile) -> Iterator[Bench]:
    """Open the ports, identify the instruments, set their limits; the output is commanded off first.

    Raises RigError (PortHeld, TimedOut, Refused, ...), Faults, and NotConfirmedOff where the output cannot be
    switched off. At the end the output is commanded off once more, and the ports are closed.
    """
    c = file.content
    clock: Clock = VirtualClock() if c.virtual_time else RealClock()
    with ExitStack() as stack:
        ports = [c.bench.controller.port, c.bench.meter.port if c.bench.meter else ""]
        if c.simulated:
            ports = _simulated(file, clock, stack)
        _known(file)
        controller = open_controller(c.bench.controller.driver, ports[0], clock, **_controller_options(file))
        stack.callback(controller.close)
        stack.enter_context(_output_off(controller, c.bench.controller.port))
        identities = {"controller": controller.identify()}
        controller.configure(c.limits.current_A, c.limits.temperature_degC, c.bench.controller.dead_man_s)
        meter = None
        if c.bench.meter is not None:
            meter = open_meter(c.bench.meter.driver, ports[1], clock)
            stack.callback(meter.close)
            identities["meter"] = meter.identify()
            try:
                meter.configure(c.bench.meter.four_wire, c.bench.meter.nplc, c.limits.meter_current_A)
            except ValueError as error:
                raise fault(file.path, "bench.meter, limits.meter_current_A", str(error)) from None
        yield Bench(controller, meter, clock, c.virtual_time, identities)


@contextmanager
def _output_off(controller: TemperatureController, port: str) -> Iterator[None]:
    """Output off before and after, whatever happens in between; an error is told whether that is confirmed.

    Raises NotConfirmedOff, which outranks all others.
    """
    text = f"{port}: the controller did not confirm that its output is off"
    if not controller.off():
        raise NotConfirmedOff(text)
    try:
        yield
    except NotConfirmedOff:
        controller.off()
        raise
    except BaseException as error:
        if not controller.off():
            raise NotConfirmedOff(f"{text} (after: {error})") from error
        error.add_note(OFF_CONFIRMED)
        raise
    if not controller.off():
        raise NotConfirmedOff(text)


def _known(file: ConfigurationFile) -> None:
    """Refuse a driver that does not exist. Raises Faults."""
    from rig.drivers import registry

    bench = file.content.bench
    roles = [("controller", bench.controller.driver, registry.CONTROLLERS)]
    if bench.meter is not None:
        roles.append(("meter", bench.meter.driver, registry.METERS))
    for role, name, known in roles:
        if name not in known:
            raise fault(file.path, f"bench.{role}.driver", f"{name!r} is none of {', '.join(sorted(known))}")


def _controller_options(file: ConfigurationFile) -> dict[str, int]:
    """What the configuration says beyond the port."""
    address = file.content.bench.controller.address
    return {"address": address} if address else {}


def emulated_instruments(file: ConfigurationFile, start_s: float) -> list[tuple[str, str, Instrument]]:
    """(role, driver's name, emulator) of the configured instruments; they share one plant. Raises Faults."""
    c = file.content
    roles = [("controller", c.bench.controller.driver, CONTROLLERS)]
    if c.bench.meter is not None:
        roles.append(("meter", c.bench.meter.driver, METERS))
    for role, name, known in roles:
        if name not in known:
            raise fault(file.path, f"bench.{role}.driver", f"{name!r} has no emulator; there are {', '.join(known)}")
    plant = SimulatedPlant(simulated_world(file), start_s)
    make = {"controller": emulated_controller, "meter": emulated_meter}
    return [(role, name, make[role](name, plant, start_s)) for role, name, _ in roles]


def _simulated(file: ConfigurationFile, clock: Clock, stack: ExitStack) -> list[str]:
    """The emulated instruments registered with the clock: their addresses."""
    addresses = []
    for role, _, instrument in emulated_instruments(file, clock.now_s()):
        name = f"{role}-{next(_numbers)}"
        addresses.append(register(name, instrument, clock))
        stack.callback(unregister, name)
    return [*addresses, ""]
