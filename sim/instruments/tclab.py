"""TCLab, the Temperature Control Lab.

Source: the board's public firmware, TCLab-sketch 1.4.0 and 2.0.1. A command is a line that ends in CR or LF, in any
case of letters; an empty one is nothing, an unknown one switches both heaters off and is answered with itself. A word's
number is read as far as it is one, else it is 0. Replies end in CR LF; the board does nothing else while it sends one.
In the plant are one heater and its thermometer; the other heater's power warms nothing, its thermometer reads the air
around. Not emulated: that opening the port restarts an Arduino Uno, and that a line ends at its 65th character.
"""

from __future__ import annotations

import re
from collections import deque
from math import isnan

from sim.instruments.instrument import Instrument, Plant

# of the board's converter: 3.3 V in 1024 steps, a TMP36 at 10 mV/K with 0.5 V at 0 degC
DEGC_PER_STEP, LOWEST_DEGC, LARGEST_STEP = 0.3223, -50.0, 1023
FULL_PWM = 200  # of 255, the firmware's power limit of heater 1: full drive
COMMAND_S = 0.0003  # that the board takes for a command
NUMBER = re.compile(r"[+-]?\d*\.?\d*")


class TcLab(Instrument):
    """One board. version: of its firmware. heater: the one that is on the plate.

    full_drive_A: current into the plant at 100 % with the usual power limit, 200. baudrate: of the line, 1/s; inf takes
    no time.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        version: str = "1.4.0",
        heater: int = 1,
        full_drive_A: float = 1.0,
        baudrate: float = 115200.0,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant, byte_s=10.0 / baudrate, start_s=start_s)
        self._version = tuple(int(part) for part in re.findall(r"\d+", version)[:3])
        self._identity = f"TCLab Firmware {version} Arduino Uno"
        self._heater, self._full_drive_A = heater, full_drive_A
        self._lines: deque[bytes] = deque()
        self.heaters = {1: 0.0, 2: 0.0}  # percent
        self.power_limits = {1: float(FULL_PWM), 2: 100.0}
        self.led_percent = 100.0

    # ---- the line -------------------------------------------------------------------------------

    def _take_line(self, line: bytes, arrival_s: float) -> None:
        if line:
            self._lines.append(line)
            self._plant.schedule(arrival_s, self._work)

    def _next_reply_s(self) -> float | None:
        return max(self._receiving_until_s, self._sending_until_s) if self._lines else None

    def _work(self, time_s: float) -> None:
        """Obey the next command, once the reply to the one before has been sent."""
        if time_s < self._sending_until_s:
            self._plant.schedule(self._sending_until_s, self._work)
            return
        line = self._lines.popleft()
        replies = self._obey(line.upper().decode("latin-1"))  # bytes: only ASCII letters become capitals
        self._sending_until_s = time_s + COMMAND_S
        if replies:
            self._send("".join(f"{reply}\r\n" for reply in replies).encode("latin-1"), time_s)

    # ---- commands -------------------------------------------------------------------------------

    def _obey(self, line: str) -> list[str]:
        word, space, rest = line.partition(" ")
        name = word.strip()
        value = _number(rest if space else line)
        number = int(name[1]) if name[1:] in ("1", "2") else 0
        if number and name[0] in "QR":
            if name[0] == "Q":
                self._heat(number, value)
            return [self._measured(self.heaters[number])]
        if number and name[0] == "P":
            self.power_limits[number] = min(255.0, max(0.0, value))
            return [f"{self.power_limits[number]:.2f}"]
        if number and name[0] == "T":
            return [self._measured(self._temperature_degC(number))]
        if name == "VER":
            return [self._identity]
        if name == "SCAN":
            temperatures = [self._temperature_degC(number) for number in (1, 2)]
            return [self._measured(value) for value in (*temperatures, *self.heaters.values())]
        if name == "LED":
            self.led_percent = min(100.0, max(0.0, value))
            return [f"{self.led_percent:.2f}"]
        if not name:
            return []
        self._heat(1, 0.0)
        self._heat(2, 0.0)
        if name == "A":
            return ["Start"]
        return ["Stop" if name == "X" and self._version >= (1, 4, 2) else name]

    def _measured(self, value: float) -> str:
        return f"{value:.3f}" if self._version >= (2,) else f"{value:.2f}"

    def _temperature_degC(self, number: int) -> float:
        """Return the mean of the board's conversions, ten from version 1.6.0 on."""
        count = 10 if self._version >= (1, 6) else 1
        return sum(self._converted_degC(number) for _ in range(count)) / count

    def _converted_degC(self, number: int) -> float:
        plant = self._plant
        here = plant.read_temperature_degC() if number == self._heater else plant.sink_temperature_degC()
        step = LARGEST_STEP if isnan(here) else int((here - LOWEST_DEGC) / DEGC_PER_STEP)
        return min(LARGEST_STEP, max(0, step)) * DEGC_PER_STEP + LOWEST_DEGC

    def _heat(self, number: int, percent: float) -> None:
        self.heaters[number] = min(100.0, max(0.0, percent))
        if number == self._heater:
            pwm = int(self.heaters[number] * self.power_limits[number] / 100.0)
            current_A = pwm / FULL_PWM * self._full_drive_A
            if current_A != self._plant.current_A:
                self._plant.set_current_A(current_A)


def _number(text: str) -> float:
    """Return the number that a text begins with, else 0."""
    found = NUMBER.match(text.strip())
    try:
        return float(found[0]) if found is not None else 0.0
    except ValueError:
        return 0.0
