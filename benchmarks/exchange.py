"""What one exchange costs in virtual time: driver, transport, pyserial port, emulator; the plant does
nothing.

    python benchmarks/exchange.py [--json FILE]

A simulated hour at 10 Hz has 36000 control periods. Targets: 20 us a MeCom exchange, 25 us any other. A temperature of
the TE Technology controller, and a setpoint, are three exchanges.
"""

from __future__ import annotations

import argparse
import heapq
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rig.core.clock import VirtualClock
from rig.drivers.registry import open_controller, open_meter
from rig.ports import protocol_sim
from sim.instruments.registry import emulated_controller, emulated_meter

REPEATS, ROUNDS = 5000, 5


class NoPlant:
    """Events only; every reading is a constant."""

    current_A = 0.0

    def __init__(self) -> None:
        self._due: list[tuple[float, int, Callable[[float], None]]] = []
        self._count = 0

    def advance_to(self, time_s: float) -> None:
        """Run what is due."""
        while self._due and self._due[0][0] <= time_s:
            due_s, _, callback = heapq.heappop(self._due)
            callback(due_s)

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        """Run `callback` at `time_s`."""
        self._count += 1
        heapq.heappush(self._due, (time_s, self._count, callback))

    def set_current_A(self, current_A: float) -> None:
        """Ignored."""

    def read_temperature_degC(self) -> float:
        """25 degC."""
        return 25.0

    def sink_temperature_degC(self) -> float:
        """20 degC."""
        return 20.0

    def read_resistance_ohm(self, test_current_A: float) -> float:
        """50 kohm."""
        return 5e4

    def read_voltage_V(self) -> float:
        """0 V."""
        return 0.0

    def set_test_current_A(self, test_current_A: float) -> None:
        """Ignored."""


def cost_us(action: Callable[[], object]) -> float:
    """Least time of an action over some rounds, us."""
    rounds = []
    for _ in range(ROUNDS):
        begin_s = time.perf_counter()
        for _ in range(REPEATS):
            action()
        rounds.append((time.perf_counter() - begin_s) / REPEATS * 1e6)
    return min(rounds)


def period_us() -> float:
    """A control period of the fastest pair."""
    clock, plant = VirtualClock(), NoPlant()
    tec = protocol_sim.register("period-tec", emulated_controller("meerstetter", plant), clock)
    dmm = protocol_sim.register("period-dmm", emulated_meter("keithley2000", plant), clock)
    controller, meter = open_controller("meerstetter", tec, clock), open_meter("keithley2000", dmm, clock)
    controller.configure(4.0, (10.0, 95.0), 5.0)
    controller.arm_current()
    meter.configure(True, 1.0, 1e-3)
    period = [0]

    def step() -> None:
        begin_s = clock.now_s()
        meter.start_reading()
        controller.read_temperature()
        period[0] += 1
        controller.set_current_A(0.001 * (period[0] % 1000))
        meter.finish_reading()
        clock.sleep_until_s(begin_s + 0.1)

    return cost_us(step)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    rows: dict[str, float] = {}
    for name in ("meerstetter", "srs_ldc500", "te_technology"):
        clock, plant = VirtualClock(), NoPlant()
        address = protocol_sim.register(f"exchange-{name}", emulated_controller(name, plant), clock)
        controller = open_controller(name, address, clock)
        controller.configure(4.0, (10.0, 95.0), 5.0)
        rows[f"{name}: read_temperature"] = cost_us(controller.read_temperature)
        if controller.commands_current:
            controller.arm_current()
            rows[f"{name}: set_current_A"] = cost_us(lambda one=controller: one.set_current_A(1.0))
        else:
            controller.arm_setpoint()
            rows[f"{name}: set_setpoint_degC"] = cost_us(lambda one=controller: one.set_setpoint_degC(30.0))
    for name in ("hp34401a", "keithley2000", "keithley2400"):
        clock, plant = VirtualClock(), NoPlant()
        address = protocol_sim.register(f"exchange-{name}", emulated_meter(name, plant), clock)
        meter = open_meter(name, address, clock)
        meter.configure(True, 1.0, 1e-3)
        rows[f"{name}: read_resistance"] = cost_us(meter.read)
    rows["one period: T, I, R"] = period_us()
    rows["a simulated hour at 10 Hz, s"] = rows["one period: T, I, R"] * 36000 * 1e-6
    for name, value in rows.items():
        print(f"{name:32s} {value:8.2f}" + ("" if name.endswith("s") and "hour" in name else " us"))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
