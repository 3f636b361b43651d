"""The bench put together: the only place that chooses between real and simulated instruments."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from rig.config.configuration import ConfigurationFile
from rig.config.effect_tables import switch_effects
from rig.config.model_file import read_model
from rig.config.tables import ControllerTable, MeterTable, ModelFilmTable, RelayFilmTable
from rig.core.clock import Clock, RealClock, VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, PortHeld, TimedOut, called, of_whom
from rig.core.faults import Faults, fault
from rig.core.outcome import NotConfirmedOff, OfOutput
from rig.core.reading import Identity
from rig.drivers.controller import TemperatureController
from rig.drivers.meter import ResistanceMeter
from rig.drivers.registry import check_options, controller_class, meter_class, open_controller, open_meter
from rig.guard.pipe import UNGUARDED, Guard
from rig.ports.open import open_elsewhere
from rig.ports.protocol_sim import register, unregister
from rig.ports.transport import nobody_answers
from rig.records.film_output import in_decades
from rig.safety.signals import SignalStop
from rig.safety.switching_off import off_confirmed, switch_off
from sim.effects.effect import Switched, switched
from sim.effects.heat_sink_warmup import EFFECT as HEAT_SINK_WARMUP
from sim.instruments.instrument import EMULATORS, Instrument, emulated, emulator_options
from sim.model.film_side import Film
from sim.model.links import links_of
from sim.world.films import PreisachFilm, film_of_world
from sim.world.plant import Detector, SimulatedPlant, World


def simulated_film(file: ConfigurationFile) -> tuple[Film, str]:
    """Return the true film, and the memory that it starts with."""
    table = file.content.simulation.film
    if isinstance(table, ModelFilmTable):
        model = read_model(file.beside(table.model), needs=("film",)).film
        assert model is not None
        meter = file.content.bench.meter
        if meter is not None and meter.quantity == "resistance" and not in_decades(model.output):
            text = f"its film's output is {model.output!r}; expected a resistance to be read in ohms, or a meter"
            raise fault(file.path, "simulation.film.model", f"{text} with quantity = 'voltage'")
        return film_of_world(model), model.initial
    assert isinstance(table, RelayFilmTable)
    film = PreisachFilm.bell_shaped(
        table.seed,
        table.relays,
        table.mean_degC,
        table.spread_K,
        table.halfwidth_K,
        table.halfwidth_sigma,
        table.decades,
        table.memoryless.memoryless(),
    )
    return film, "cooled"


def simulated_effects(file: ConfigurationFile) -> tuple[Switched, ...]:
    """Return the effects that are switched on. Raises Faults, as for an effect that two places switch on."""
    table = file.content.simulation
    effects, _ = switch_effects(table.effects, "simulation.effects", complete=False)
    if table.heat_sink_warmup is not None:
        effects += (switched(HEAT_SINK_WARMUP, table.heat_sink_warmup.model_dump()),)
    if isinstance(table.film, ModelFilmTable):
        effects += read_model(file.beside(table.film.model)).switched()
    return effects


def simulated_world(file: ConfigurationFile) -> World:
    """Return what is true of the simulated rig. Raises Faults if a model file is wrong."""
    table = file.content.simulation
    film, initial = simulated_film(file)
    effects = simulated_effects(file)
    try:
        links_of(effects)
    except ValueError as error:
        raise fault(file.path, "simulation.effects", f"{error}, with those of simulation.film's model") from None
    return World(
        plate=table.plate.model(),
        film=film,
        first_degC=table.first_degC,
        film_initial=initial,
        thermometer_noise_K=table.thermometer_noise_K,
        ohmmeter_noise_dec=table.ohmmeter_noise_dec,
        seed=table.seed,
        effects=effects,
        detector=Detector(**table.detector.model_dump()) if table.detector is not None else None,
    )


class OutputOff:
    """Context that ends with the controller's output off, whatever happens, and knows whether that is confirmed.

    table: where the controller is, for the error. signals: held back from the moment at which the output goes off, as
    long as an error is on its way; None: of the bench, whose output is commanded off at the beginning as well, and for
    whose output the guard answers until the end, or until everything has been tried and that is told.
    Raises NotConfirmedOff, which outranks all others; after it nothing is sent any more, which would only feed the
    controller's dead man.
    """

    def __init__(
        self,
        controller: TemperatureController,
        table: ControllerTable,
        guard: Guard = UNGUARDED,
        signals: SignalStop | None = None,
    ) -> None:
        self._controller, self._table = controller, table
        self._guard, self._signals = guard, signals
        self.confirmed: bool | None = None

    def __enter__(self) -> OutputOff:
        if self._signals is None:
            self._switch_off(None)
            self._guard.idle()  # where it had armed the output before, and lost it: that is over
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self._signals is not None:
            self._signals.shield()
        if isinstance(error, NotConfirmedOff):
            self.confirmed = False
            self._guard.given_up()
            return
        self._switch_off(error)
        if self._signals is None:
            self._guard.let_go()
            if error is not None:
                error.add_note(OfOutput(off_confirmed(self._controller)))
            return
        self._guard.idle()
        if error is None:
            self._signals.expose()

    def _switch_off(self, error: BaseException | None) -> None:
        """Raises NotConfirmedOff."""
        verdict = switch_off(self._controller, alive=self._guard.alive)
        self.confirmed = verdict.confirmed
        if not verdict.confirmed:
            self._guard.given_up()
            port, driver = self._table.port, self._table.driver
            who = called(port, "controller", driver)
            reason = f"; before that: {str(error).removeprefix(f'{who}: ')}" if error is not None else ""
            silent = nobody_answers(self._controller, port, "controller", driver, "to switch its output off")
            raise NotConfirmedOff(silent or f"{port}: {verdict.text}{reason}") from error
        if verdict.text and error is not None:
            error.add_note(verdict.text)


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
        if table.driver not in EMULATORS:
            expected = f"{table.driver!r} has no emulator; there are {', '.join(EMULATORS)}"
            raise fault(file.path, f"bench.{role}.driver", expected)
        driver = controller_class(table.driver) if role == "controller" else meter_class(table.driver)
        try:
            check_options(role, table.driver, driver, table.options)
        except ValueError as error:
            raise fault(file.path, f"bench.{role}.options", str(error)) from None
    plant = SimulatedPlant(simulated_world(file), start_s) if plant is None else plant
    return [(role, table.driver, emulated(table.driver, plant, start_s, **_shared(table))) for role, table in roles]


def _shared(table: ControllerTable | MeterTable) -> dict[str, Any]:
    """Return the driver's options that its emulator has too, such as a model or an address."""
    known = emulator_options(table.driver)
    return {name: value for name, value in table.options.items() if name in known}


def _simulated(file: ConfigurationFile, clock: Clock, stack: ExitStack) -> list[str]:
    """Register the emulated instruments with the clock; return their addresses."""
    addresses = []
    for role, _, instrument in emulated_instruments(file, clock.now_s()):
        name = f"{role}-{next(_numbers)}"
        addresses.append(register(name, instrument, clock))
        stack.callback(unregister, name)
    return [*addresses, ""]
