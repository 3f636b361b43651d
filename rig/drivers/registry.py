"""Drivers by the name that a configuration gives them; only the one that is used is imported.

A driver of the user's own is one file, named with its class: "/home/ada/bath.py:Bath" (docs/own_driver.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from inspect import signature
from pathlib import Path
from typing import Any, cast

from rig.core.clock import Clock
from rig.core.errors import called
from rig.drivers.controller import TemperatureController
from rig.drivers.meter import Meter
from rig.drivers.option_kinds import check_kinds
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Port, Transport

# name -> module in rig.drivers, class
CONTROLLERS = {
    "lakeshore": ("lakeshore", "LakeShoreController"),
    "meerstetter": ("meerstetter", "MeerstetterController"),
    "srs_ldc500": ("srs_ldc500", "SrsLdc500Controller"),
    "tclab": ("tclab", "TcLabController"),
    "te_technology": ("te_technology", "TeTechnologyController"),
}
METERS = {
    "hp34401a": ("hp34401a", "Hp34401AMeter"),
    "keithley2000": ("keithley2000", "Keithley2000Meter"),
    "keithley2400": ("keithley2400", "Keithley2400Meter"),
    "keithley2450": ("keithley2450", "Keithley2450Meter"),
}

OF_THE_LINE = ("baud", "framing")  # options that are not the driver's
OF_A_FORMULA = ("formula", "output", "range_V")  # nor these, of a meter

# what a driver of the user's own has to have
OPTIONAL = {"transport", "confirms_off_by", "dead_man_s", "clear_error"}
CONTROLLER_MEMBERS = {name for name in vars(TemperatureController) if not name.startswith("_")}
CONTROLLER_MEMBERS |= set(TemperatureController.__annotations__)
CONTROLLER_MEMBERS -= OPTIONAL
METER_MEMBERS = {name for name in vars(Meter) if not name.startswith("_")} | {"LINE"}

# Of a conversation, random by default. Their digits are bytes, and bytes are time on a simulated line: with random ones
# each reading of a simulation was up to two milliseconds earlier or later than the time before.
FIRST_NUMBERS = ("first_token", "first_sequence")


def open_controller(name: str, port: str, clock: Clock, **options: Any) -> TemperatureController:
    """The temperature controller `name` at `port`.

    Of the options `baud` (1/s) and `framing` ("8N1") change the line's settings, from what the driver says; the others
    go to the driver. An unknown name, and an option that the driver does not have, is a ValueError; PortHeld,
    Disconnected. Nothing is sent yet.
    """
    return cast(TemperatureController, _open(CONTROLLERS, "controller", name, port, clock, options))


def open_meter(name: str, port: str, clock: Clock, **options: Any) -> Meter:
    """The meter `name` at `port`; otherwise as `open_controller`.

    With the options `formula`, `output` and `range_V` it reads a voltage that stands for another quantity
    (`rig.drivers.formula_meter`).
    """
    wrapped = {key: options.pop(key) for key in OF_A_FORMULA if key in options}
    if wrapped:
        from rig.drivers.formula import formula
        from rig.drivers.formula_meter import FormulaMeter, check_output

        if not {"formula", "output"} <= wrapped.keys():
            raise ValueError("a meter of another quantity needs both, a formula and an output")
        formula(wrapped["formula"])  # before anything is opened
        check_output(wrapped["output"])
    meter = _open(METERS, "meter", name, port, clock, options)
    if not wrapped:
        return cast(Meter, meter)
    if not hasattr(meter, "configure_voltage"):
        meter.close()
        raise ValueError(f"meter {name!r} reads no voltages")
    return FormulaMeter(meter, wrapped["output"], wrapped["formula"], wrapped.get("range_V", 10.0))


def is_own(name: str) -> bool:
    """Whether a driver's name is that of a file and a class in it."""
    return ".py:" in name


def beside(name: str, folder: Path) -> str:
    """A driver's name; where it is that of a file, with the file taken from beside a configuration in that folder."""
    return str((folder / name).absolute()) if is_own(name) else name


def driver_class(drivers: dict[str, tuple[str, str]], role: str, name: str) -> Any:
    """The class of a driver. ValueError where there is none."""
    if is_own(name):
        return _own_class(role, name)
    if name not in drivers:
        raise ValueError(f"{role} {name!r} is not known; there are {', '.join(sorted(drivers))}")
    module, kind = drivers[name]
    return getattr(import_module(f"rig.drivers.{module}"), kind)


def controller_class(name: str) -> Any:
    """The class of a controller's driver. ValueError where there is none."""
    return driver_class(CONTROLLERS, "controller", name)


def meter_class(name: str) -> Any:
    """The class of a meter's driver. ValueError where there is none."""
    return driver_class(METERS, "meter", name)


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
    needed = CONTROLLER_MEMBERS if role == "controller" else METER_MEMBERS
    missing = sorted(member for member in needed if not hasattr(driver, member))
    if driver is None or missing:
        what = f"it lacks {', '.join(missing)}" if driver is not None else f"there is no class {kind} in it"
        raise ValueError(f"{role} {name!r}: {what}")
    return driver


def check_options(role: str, name: str, driver: Any, options: Mapping[str, Any]) -> None:
    """Raises ValueError for an option that a driver does not have, or one of another kind than its own."""
    known = set(signature(driver).parameters) - {"transport", "line"}
    others = (*OF_THE_LINE, *OF_A_FORMULA) if role == "meter" else OF_THE_LINE
    own = {key: value for key, value in options.items() if key not in others}
    if not own.keys() <= known:
        unknown = ", ".join(sorted(own.keys() - known))
        raise ValueError(
            f"{role} {name!r} has no option {unknown}; there are {', '.join((*OF_THE_LINE, *sorted(known)))}"
        )
    check_kinds(driver, own)
    if hasattr(driver, "line_for"):
        driver.line_for(**own)


def _open(
    drivers: dict[str, tuple[str, str]],
    role: str,
    name: str,
    port: str,
    clock: Clock,
    options: dict[str, Any],
) -> Any:
    driver = driver_class(drivers, role, name)
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
    if port.startswith("sim://"):  # nobody's old answers are in that line, and a simulation is the same each time
        options = {**dict.fromkeys(signature(driver).parameters.keys() & set(FIRST_NUMBERS), 1), **options}
    try:
        return driver(Transport(cast(Port, opened), clock, called(port, role, name)), line=line, **options)
    except BaseException:
        opened.close()
        raise
