"""Drivers and emulators by name: every configuration name has both; what options change."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.drivers import registry as drivers
from rig.ports.open import LineSettings
from sim.instruments import instrument as emulators
from sim.instruments.instrument import Instrument
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
CONTROLLERS = tuple(sorted(drivers.CONTROLLERS))
WITH_ADDRESS = ("meerstetter", "te_technology")
METERS = tuple(sorted(drivers.METERS))


def opened(name: str, port: str, clock: VirtualClock, **options: Any) -> Any:
    return (drivers.open_controller if name in CONTROLLERS else drivers.open_meter)(name, port, clock, **options)


def emulated(name: str, plant: StillPlant, **options: Any) -> Instrument:
    return emulators.emulated(name, plant, **options)


def test_both_registries_have_the_same_names() -> None:
    assert sorted(emulators.EMULATORS) == sorted(CONTROLLERS + METERS)


@pytest.mark.parametrize("name", CONTROLLERS + METERS)
def test_an_emulator_has_its_drivers_speed(attach: Attach, clock: VirtualClock, plant: StillPlant, name: str) -> None:
    instrument = emulated(name, plant)
    driver = opened(name, attach(instrument), clock)
    assert driver.LINE.byte_s == pytest.approx(instrument._byte_s)  # type: ignore[attr-defined]
    driver.identify()


@pytest.mark.parametrize("name", CONTROLLERS + METERS)
def test_baud_reaches_the_port_and_the_link(attach: Attach, clock: VirtualClock, plant: StillPlant, name: str) -> None:
    driver = opened(name, attach(emulated(name, plant, baudrate=1200.0)), clock, baud=1200)
    port = driver.transport.port
    assert (port.baudrate, port.bytesize, port.parity) == (1200, driver.LINE.bytesize, driver.LINE.parity)
    assert driver.link._byte_s == pytest.approx(driver.LINE.byte_s * driver.LINE.baudrate / 1200)
    driver.identify()
    if name in METERS:
        driver.configure(True, 0.2, 1e-3)
        driver.read()
        assert driver.read().time_s == pytest.approx(plant.sampled_s, abs=2e-3)
    else:
        resolution_K = 0.33 if name == "tclab" else 0.0
        assert driver.read_temperature().value == pytest.approx(25.0, abs=resolution_K)


def test_a_model_has_its_own_line(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    address = attach(emulators.emulated("te_technology", plant, model="tc-48-20"))
    driver = drivers.open_controller("te_technology", address, clock, model="tc-48-20")
    assert driver.transport.port.baudrate == 115200  # type: ignore[attr-defined]


def test_framing(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    address = attach(emulated("hp34401a", plant))
    port = drivers.open_meter("hp34401a", address, clock, framing="8N2", baud=4800).transport.port
    found = LineSettings(port.baudrate, port.bytesize, port.parity, port.stopbits)  # type: ignore[attr-defined]
    assert found == LineSettings(4800, 8, "N", 2)
    for framing in ("8N", "9N1", "8X1", "8N3"):
        with pytest.raises(ValueError, match="expected"):
            LineSettings().framed(framing)


@pytest.mark.parametrize(
    ("line", "bits"),
    [(LineSettings(), 10), (LineSettings(parity="E"), 11), (LineSettings(bytesize=7, parity="E", stopbits=2), 11)],
)
def test_time_of_a_character(line: LineSettings, bits: int) -> None:
    assert line.byte_s == pytest.approx(bits / 9600)


WRONG_OPTIONS: dict[str, list[dict[str, Any]]] = {
    "te_technology": [{"model": "tc-24-25"}, {"units": "K"}, {"address": 256}],
    "srs_ldc500": [{"heating_sign": 2}, {"nonsense": 1}, {"transport": None}, {"baud": "x"}],
    "lakeshore": [{"input": "E"}, {"output": 3}, {"range": "highest"}, {"max_current_A": 3.0}, {"p": 10.0}],
    "tclab": [{"heater": 3}, {"boot_s": -1.0}, {"line": LineSettings()}],
    "keithley2000": [
        {"nonsense": 1},
        {"baud": 0},
        {"formula": "voltage_V"},
        {"output": "curvature_per_m"},
        {"formula": "1", "output": "curvature_per_m"},
        {"formula": "voltage_V", "output": "curvature"},
        {"formula": "voltage_V", "output": "resistance_ohm"},
    ],
}


@pytest.mark.parametrize(("name", "options"), [(name, o) for name, all_ in WRONG_OPTIONS.items() for o in all_])
def test_wrong_options_open_nothing(
    attach: Attach, clock: VirtualClock, plant: StillPlant, name: str, options: dict[str, Any]
) -> None:
    """Whoever corrects one would find the port held by the program that refused it."""
    address = attach(emulated(name, plant))
    with pytest.raises(ValueError, match=r"no option|expected|formula|output|heating sign|all three"):
        opened(name, address, clock, **options)
    opened(name, address, clock)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_an_address_goes_to_drivers_with_one(attach: Attach, clock: VirtualClock, plant: StillPlant, name: str) -> None:
    address = attach(emulated(name, plant, **({"address": 3} if name in WITH_ADDRESS else {})))
    if name not in WITH_ADDRESS:
        with pytest.raises(ValueError, match="no option address"):
            opened(name, address, clock, address=3)
    else:
        assert opened(name, address, clock, address=3).read_temperature().value == 25.0


def test_unknown_names() -> None:
    for open_one, names in ((drivers.open_controller, CONTROLLERS), (drivers.open_meter, METERS)):
        with pytest.raises(ValueError, match=f"'fluke' is not known; there are {', '.join(names)}"):
            open_one("fluke", "sim://x", VirtualClock())
    with pytest.raises(KeyError):
        emulators.emulated("fluke", StillPlant())


def test_only_the_driver_that_is_asked_for_is_imported() -> None:
    script = (
        "import sys, rig.drivers.registry as r; from rig.core.clock import VirtualClock\n"
        "try: r.open_controller('meerstetter', 'sim://nobody', VirtualClock())\n"
        "except Exception: pass\n"
        "print('rig.drivers.meerstetter' in sys.modules, 'rig.drivers.scpi_meters' in sys.modules,"
        " 'sim.instruments.multimeters' in sys.modules, 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False", "False", "False"]
