"""Drivers by the name that a configuration gives them: opened, and searched for. Only the one that is used is imported.

A user-defined driver is one file, named with its class: "/home/ada/bath.py:Bath" (docs/own_driver.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from inspect import signature
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, NamedTuple, cast, get_args, get_origin, get_type_hints

from rig.core.clock import Clock
from rig.core.errors import InstrumentError, called
from rig.core.reading import Identity
from rig.drivers.controller import OwnField, TemperatureController
from rig.drivers.meter import FormulaMeter, Meter, check_output, formula
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Port, Transport, not_understood

if TYPE_CHECKING:
    from compensator.control.pid import OwnPid

# role, module and class of each driver by its name, in the order in which they ask at a port (`tries`): those whose
# frames have a checksum first
DRIVERS = {
    "meerstetter": ("controller", "meerstetter", "MeerstetterController"),
    "te_technology": ("controller", "te_technology", "TeTechnologyController"),
    "keithley2000": ("meter", "scpi_meters", "Keithley2000Meter"),
    "keithley2400": ("meter", "scpi_meters", "Keithley2400Meter"),
    "keithley2450": ("meter", "scpi_meters", "Keithley2450Meter"),
    "hp34401a": ("meter", "scpi_meters", "Hp34401AMeter"),
    "lakeshore": ("controller", "lakeshore", "LakeShoreController"),
    "srs_ldc500": ("controller", "srs_ldc500", "SrsLdc500Controller"),
    "tclab": ("controller", "tclab", "TcLabController"),
}
CONTROLLERS = sorted(name for name, (role, *_) in DRIVERS.items() if role == "controller")
METERS = sorted(name for name, (role, *_) in DRIVERS.items() if role == "meter")

OF_THE_LINE = ("baud", "framing")  # options that are not the driver's
OF_A_FORMULA = ("formula", "output", "range_V")  # nor these, of a meter
# that a user-defined controller may lack
OPTIONAL = {"transport", "confirms_off_by", "dead_man_s", "clear_error", "NAME", "LARGEST_CURRENT", "drive_unit"}
OPTIONAL |= {"cools", "link", "current_limit_A", "temperature_limits_degC"}
IN_WORDS = {int: "a whole number", float: "a finite number", str: "text in quotes", bool: "true or false"}
OpenPort = Callable[[str, LineSettings], Any]


# ---- classes ----------------------------------------------------------------------------------------


def is_own(name: str) -> bool:
    """Return True if a driver's name is that of a file and a class in it."""
    return ".py:" in name


def beside(name: str, folder: Path) -> str:
    """Return a driver's name; that of a user-defined one with its file in the configuration's folder."""
    return str((folder / name).absolute()) if is_own(name) else name


def controller_class(name: str) -> Any:
    """Return the class of a controller's driver; ValueError if there is none."""
    return _driver_class("controller", name)


def meter_class(name: str) -> Any:
    """Return the class of a meter's driver; ValueError if there is none."""
    return _driver_class("meter", name)


def _driver_class(role: str, name: str) -> Any:
    if is_own(name):
        return _own_class(role, name)
    known = CONTROLLERS if role == "controller" else METERS
    if name not in known:
        raise ValueError(f"{role} {name!r} is not known; there are {', '.join(known)}")
    _, module, kind = DRIVERS[name]
    return getattr(import_module(f"rig.drivers.{module}"), kind)


def _own_class(role: str, name: str) -> Any:
    file, _, kind = name.rpartition(":")
    path = Path(file)
    spec = spec_from_file_location(f"own_driver_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{role} {name!r}: there is no file {file}")
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{role} {name!r}: {file} cannot be imported: {type(error).__name__}: {error}") from error
    driver = getattr(module, kind, None)
    if driver is None:
        raise ValueError(f"{role} {name!r}: there is no class {kind} in it")
    protocol = TemperatureController if role == "controller" else Meter
    members = {*vars(protocol), *protocol.__annotations__} - OPTIONAL
    missing = sorted(name for name in members if not (name.startswith("_") or hasattr(driver, name)))
    if missing:
        raise ValueError(f"{role} {name!r}: it lacks {', '.join(missing)}")
    return driver


# ---- options ----------------------------------------------------------------------------------------


def check_options(role: str, name: str, driver: Any, options: Mapping[str, Any]) -> None:
    """Raise ValueError for an option that a driver does not have, or one of another kind than its own."""
    known = set(signature(driver).parameters) - {"transport", "line"}
    others = (*OF_THE_LINE, *OF_A_FORMULA) if role == "meter" else OF_THE_LINE
    own = {key: value for key, value in options.items() if key not in others}
    if not own.keys() <= known:
        unknown = ", ".join(sorted(own.keys() - known))
        raise ValueError(
            f"{role} {name!r} has no option {unknown}; there are {', '.join((*OF_THE_LINE, *sorted(known)))}"
        )
    _check_kinds(driver, own)
    if hasattr(driver, "line_for"):
        driver.line_for(**own)


def _check_kinds(driver: Any, options: Mapping[str, Any]) -> None:
    """Raise ValueError for an option of another kind than the driver's annotation, if that is a simple one."""
    try:
        hints = get_type_hints(driver.__init__)
    except (NameError, TypeError):  # of a user-defined driver, whose annotations mean nothing here
        return
    for name, value in options.items():
        hint = hints.get(name, Any)
        parts = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        kinds = [get_origin(part) or part for part in parts]
        if hint is Any or not all(isinstance(kind, type) for kind in kinds):
            continue
        if not any(_is(value, kind) for kind in kinds):
            words = [IN_WORDS.get(kind, f"a {kind.__name__}") for kind in kinds if kind is not NoneType]
            raise ValueError(f"{name} {value!r}: {' or '.join(words)} is expected")


def _is(value: Any, kind: type) -> bool:
    """Return True if a value is of a kind: a whole number is a float too; true and false are no numbers."""
    if kind is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


# ---- opening ----------------------------------------------------------------------------------------


def open_controller(
    name: str, port: str, clock: Clock, *, open_port: Any = open_port, **options: Any
) -> TemperatureController:
    """Open the temperature controller `name` at `port`; nothing is sent yet.

    Of the options `baud` (1/s) and `framing` ("8N1") change the line's settings, from what the driver says; the others
    go to the driver. An unknown name, and an option that the driver does not have, is a ValueError; PortHeld,
    Disconnected. open_port: opens the port with the settings of its line.
    """
    return cast(TemperatureController, _open("controller", name, port, clock, open_port, options))


def open_meter(name: str, port: str, clock: Clock, *, open_port: Any = open_port, **options: Any) -> Meter:
    """Open the meter `name` at `port`; otherwise as `open_controller`.

    With the options `formula`, `output` and `range_V` it reads a voltage that stands for another quantity
    (`rig.drivers.meter`).
    """
    wrapped = {key: options.pop(key) for key in OF_A_FORMULA if key in options}
    if wrapped:
        if not {"formula", "output"} <= wrapped.keys():
            raise ValueError("a meter of another quantity needs both, a formula and an output")
        formula(wrapped["formula"])  # before anything is opened
        check_output(wrapped["output"])
    meter = _open("meter", name, port, clock, open_port, options)
    if not wrapped:
        return cast(Meter, meter)
    if not hasattr(meter, "configure_voltage"):
        meter.close()
        raise ValueError(f"meter {name!r} reads no voltages")
    return FormulaMeter(meter, wrapped["output"], wrapped["formula"], wrapped.get("range_V", 10.0))


def _open(role: str, name: str, port: str, clock: Clock, open_port: OpenPort, options: dict[str, Any]) -> Any:
    driver = _driver_class(role, name)
    options = dict(options)
    baud, framing = options.pop("baud", None), options.pop("framing", None)
    check_options(role, name, driver, options)
    line: LineSettings = driver.line_for(**options) if hasattr(driver, "line_for") else driver.LINE
    if baud is not None:
        if not (isinstance(baud, int) and baud > 0):
            raise ValueError(f"baud {baud!r}: a positive whole number is expected")
        line = replace(line, baudrate=baud)
    if framing is not None:
        line = line.framed(str(framing))
    opened = open_port(port, line)
    if port.startswith("sim://") and "first_token" in signature(driver).parameters:
        # a random one has more digits or fewer, which take time: a simulated reading would come up to 2 ms off
        options = {"first_token": 1, **options}
    try:
        return driver(Transport(cast(Port, opened), clock, called(port, role, name)), line=line, **options)
    except BaseException:
        opened.close()
        raise


# ---- searching --------------------------------------------------------------------------------------


class Tried(NamedTuple):
    """A driver that asked at a port: the identity that answered it, None for no answer; what came instead, in words."""

    driver: str
    identity: Identity | None
    came: str | None = None


def searches(port: str) -> list[tuple[str, str, dict[str, Any]]]:
    """Return role, name and options of the drivers that ask at a port, in their order.

    A driver's SEARCH has the options to ask with, one set after the other; ON_VISA is False for one whose lines do not
    end in LF, as those on VISA's buses do.
    """
    found: list[tuple[str, str, dict[str, Any]]] = []
    for name, (role, *_) in DRIVERS.items():
        kind = _driver_class(role, name)
        if not port.startswith("visa://") or getattr(kind, "ON_VISA", True):
            asked_with: tuple[dict[str, Any], ...] = getattr(kind, "SEARCH", ({},))
            found += [(role, name, options) for options in asked_with]
    return found


def tries(
    port: str, clock: Clock, asks: Callable[[str], None] = lambda _: None, first: Collection[str] = ()
) -> Iterator[Tried]:
    """Let each driver ask at a port who is there, until one is answered. PortHeld, Disconnected.

    The questions change nothing, but any instrument there receives them: only if the user says so. asks: called before
    each driver with a text that names it, as a port that stays silent costs some seconds a driver. first: drivers that
    are likely there.
    """
    tried = sorted(searches(port), key=lambda one: one[1] not in first)
    for k, (role, name, options) in enumerate(tried, start=1):
        asks(f"asking as {name} does ({k} of {len(tried)})")
        instrument = (open_controller if role == "controller" else open_meter)(name, port, clock, **options)
        heard = instrument.transport
        try:
            identity = instrument.identify()
        except InstrumentError:
            yield Tried(name, None, not_understood(heard.heard, heard.lines))
        else:
            yield Tried(name, identity)
            return
        finally:
            heard.close()


# ---- a controller's own PID: a textbook one is taken, as no maker says what law is in the instrument ---


def own_fields(driver: str, options: Mapping[str, Any], pid: OwnPid, limit: float) -> list[OwnField] | None:
    """Return a PID in the fields of a driver's instrument; None if it has none of its own, or one not known here.

    limit: the current (A, or share of full drive) that is 100 % of the output.
    """
    make = getattr(controller_class(driver), "own_fields", None)
    return None if make is None else list(make(options, pid.kp_A_per_K, pid.ti_s, pid.td_s, limit))


def configured_pid(driver: str, options: Mapping[str, Any], limit: float) -> OwnPid | None:
    """Return the PID that a configuration's options set; None if they do not give all of it."""
    from compensator.control.pid import OwnPid

    fields = own_fields(driver, options, OwnPid(1.0, 1.0), limit)
    if fields is None or any(options.get(field.option) is None for field in fields):
        return None
    return set_pid([replace(field, value=float(options[field.option])) for field in fields], driver, limit)


def set_pid(fields: list[OwnField], driver: str, limit: float) -> OwnPid:
    """Return the PID that the fields set."""
    from compensator.control.pid import OwnPid

    return OwnPid(*controller_class(driver).own_pid(limit, **{field.option: field.value for field in fields}))
