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
from sim.instruments.registry import CONTROLLERS, METERS, emulated_controller, emulated_meter
from sim.plant import SimulatedPlant

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
    switched off at the start. At the end the ports are closed; that the output is off by then is the experiment's
    business.
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
        if not controller.off():
            raise NotConfirmedOff(f"{c.bench.controller.port}: the controller did not confirm that its output is off")
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


def _simulated(file: ConfigurationFile, clock: Clock, stack: ExitStack) -> list[str]:
    """Emulated instruments that share one plant, registered with the clock; their addresses."""
    c = file.content
    _known(file)
    for role, name, known in (
        ("controller", c.bench.controller.driver, CONTROLLERS),
        ("meter", c.bench.meter.driver if c.bench.meter else "", METERS),
    ):
        if name and name not in known:
            raise fault(file.path, f"bench.{role}.driver", f"{name!r} has no emulator; there are {', '.join(known)}")
    start_s = clock.now_s()
    plant = SimulatedPlant(simulated_world(file), start_s)
    number = next(_numbers)
    addresses = [register(f"controller-{number}", emulated_controller(c.bench.controller.driver, plant, start_s), clock)]
    stack.callback(unregister, f"controller-{number}")
    if c.bench.meter is not None:
        addresses.append(register(f"meter-{number}", emulated_meter(c.bench.meter.driver, plant, start_s), clock))
        stack.callback(unregister, f"meter-{number}")
    return [*addresses, ""]
