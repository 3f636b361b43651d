"""What stands at the end of the bad cable: an instrument with its driver, and a world whose readings tell their time.

Shared by the tests of the drivers and by benchmarks/wire.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from rig.core.clock import VirtualClock
from rig.core.errors import InstrumentError
from rig.core.reading import Reading
from rig.drivers import registry
from rig.drivers.registry import open_controller, open_meter
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.faulty_wire import FaultyWire
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
RATE_OHM_PER_S = 10.0
_numbers = count()


@dataclass(frozen=True)
class Case:
    """An instrument by its driver's name, and what one of its family would say unasked.

    resolution_K: of a reading; the tell-tale
    temperature rises by `rate_K_per_s`, so that a reading tells its time within the quotient of the two.
    longest_s: how long the tell-tale temperature stays within what the instrument shows. limit: of its current, or of a
    heater's drive; strong: a current, or drive, that heats.
    """

    driver: str
    foreign: bytes
    meter: bool = False
    rate_K_per_s: float = 0.01
    resolution_K: float = 1e-5
    fault_rate: float = 0.2
    longest_s: float = 2000.0
    limit: float = 4.0
    strong: float = 3.0
    emulator: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        more = self.emulator or self.options
        return " ".join(
            [self.driver, *(self._word(name, value) for name, value in more.items() if not isinstance(value, float))]
        )

    @staticmethod
    def _word(name: str, value: Any) -> str:
        return name if isinstance(value, bool) else str(value)

    @property
    def tolerance_s(self) -> float:
        """How far a reading may be from its time, s."""
        return 1e-3 if self.meter else 1e-3 + 0.6 * self.resolution_K / self.rate_K_per_s

    def is_right(self, reading: Reading, begin_s: float, end_s: float) -> bool:
        """Return True if it was sampled between question and answer, and says when."""
        sampled_s = self.sampled_s(reading)
        if not begin_s - self.tolerance_s <= sampled_s <= end_s + self.tolerance_s:
            return False
        if self.driver == "meerstetter":  # whose answer may be that to the same question, asked before
            return True
        return abs(reading.time_s - sampled_s) <= (2e-3 if self.meter else self.tolerance_s + 0.06)

    def sampled_s(self, reading: Reading) -> float:
        """When a right reading was sampled, s."""
        return (reading.value - 1e3) / RATE_OHM_PER_S if self.meter else (reading.value - 10.0) / self.rate_K_per_s


CONTROLLERS = (
    Case("meerstetter", b"!0015AB41CD2F28D5C2\r"),
    Case("te_technology", b"*00000bb8ec^", rate_K_per_s=0.5, resolution_K=0.01, fault_rate=0.1, longest_s=1100.0),
    Case(
        "te_technology",
        b"*012cf6^",
        rate_K_per_s=1.0,
        resolution_K=0.1,
        fault_rate=0.1,
        longest_s=550.0,
        emulator={"model": "tc-48-20"},
        options={"model": "tc-48-20", "units": "degC"},
    ),
    Case("srs_ldc500", b"31.25\r\n", rate_K_per_s=0.1, resolution_K=1e-3),
    Case("srs_ldc500", b"31.25;31.25;999\r\n", rate_K_per_s=0.1, resolution_K=1e-3, emulator={"joined": True}),
    Case(
        "lakeshore",
        b"+031.250\r\n",
        rate_K_per_s=0.1,
        resolution_K=1e-3,
        limit=1.0,
        strong=0.75,
        emulator={"full_drive_A": 4.0, "update_s": 0.0},
    ),
    Case(
        "tclab",
        b"31.25\r\n",
        rate_K_per_s=1.0,
        resolution_K=0.6,
        fault_rate=0.15,
        longest_s=130.0,
        limit=1.0,
        strong=0.75,
        emulator={"full_drive_A": 4.0},
    ),
)
FOREIGN = {
    "hp34401a": b"+1.23456789E+03\r\n",
    "keithley2400": b"+1.000000E-05,+1.234568E+03\n",
    "keithley2450": b"1.0000000E-05, 1.2345678E+03\n",
}
METERS = (  # each that is registered
    *(Case(name, FOREIGN.get(name, b"+1.23456789E+03\n"), meter=True) for name in registry.METERS),
    Case("keithley2400", FOREIGN["keithley2400"], meter=True, options={"output_between_readings": False}),
)


class TellTale(StillPlant):
    """Readings tell their time: temperature 10 + rate t, resistance 1000 + 10 t, so that an old one is seen."""

    def __init__(self, rate_K_per_s: float) -> None:
        super().__init__()
        self.rate_K_per_s = rate_K_per_s

    def read_temperature_degC(self) -> float:
        return 10.0 + self.rate_K_per_s * self.time_s

    def read_resistance_ohm(self, test_current_A: float) -> float:
        return 1e3 + RATE_OHM_PER_S * self.time_s


def on_wire(
    attach: Attach, clock: VirtualClock, case: Case, plant: StillPlant, seed: int, faults: tuple[str, ...], **wire: Any
) -> tuple[Any, FaultyWire]:
    """A configured meter, or a configured and armed controller, behind a wire that is still good."""
    emulator = emulated(case.driver, plant, **case.emulator)
    line = FaultyWire(emulator, seed=seed, rate=0.0, foreign=case.foreign, faults=faults, **wire)
    open_one = open_meter if case.meter else open_controller
    driver: Any = open_one(case.driver, attach(line), clock, **case.options, first_token=seed % 255 + 1)
    if case.meter:
        driver.configure(True, 1.0, 1e-3)
    else:
        driver.configure(case.limit, (-100.0, 600.0) if case.driver != "srs_ldc500" else (-100.0, 240.0), 0.0)
        driver.arm_current() if driver.commands_current else driver.arm_setpoint()
    return driver, line


@dataclass
class Tally:
    """Of some exchanges: readings that were right and wrong, and those that did not become a number."""

    right: int = 0
    wrong: int = 0
    refused: int = 0
    seconds: float = 0.0
    faults: int = 0

    @property
    def exchanges(self) -> int:
        return self.right + self.wrong + self.refused


def exchange(case: Case, seed: int, faults: tuple[str, ...], readings: int, **wire: Any) -> tuple[Tally, list[str]]:
    """Ask for so many readings over a bad wire, fewer where `longest_s` is over; and what was wrong, in words."""
    tally, found = Tally(), []
    clock = VirtualClock()
    name = f"wire-{next(_numbers)}"

    def attach(end: Instrument) -> str:
        return protocol_sim.register(name, end, clock)

    plant = TellTale(case.rate_K_per_s)
    instrument, line = on_wire(attach, clock, case, plant, seed, faults, **wire)
    ask = instrument.read if case.meter else instrument.read_temperature
    line.rate = case.fault_rate
    first_s = clock.now_s()
    for _ in range(readings):
        begin_s = clock.now_s()
        if begin_s > case.longest_s:
            break
        try:
            reading = ask()
        except InstrumentError:
            tally.refused += 1
        else:
            if not reading.is_number:
                tally.refused += 1
            elif case.is_right(reading, begin_s, clock.now_s()):
                tally.right += 1
            else:
                tally.wrong += 1
                found.append(f"{case}, seed {seed}: {reading.value!r} asked for at {begin_s!r} s")
        clock.sleep_until_s(clock.now_s() + 0.01)
    instrument.transport.close()
    protocol_sim.unregister(name)
    tally.seconds = clock.now_s() - first_s
    tally.faults = sum(line.counts.values())
    return tally, found
