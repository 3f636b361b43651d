"""What an emulated instrument knows of the world, what a port knows of it, and the line between them.

An emulator has no clock and does no input or output: time is a parameter, in seconds on any scale that does not run
backwards. The port (in this process, or a pseudo-terminal) calls `receive` with what the host has written, and
`transmit` for what has reached the host by now. `transmit` runs the physics through `Plant.advance_to`, so that
instruments on one plant see one history. A reply reaches the host in one piece when its last byte has been sent, as USB
adapters deliver it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from importlib import import_module
from inspect import signature
from math import copysign, isnan, nan
from typing import Any, ClassVar, Protocol, cast


class Plant(Protocol):
    """Part of the simulated world that an instrument measures and drives. Times are seconds on one rising scale."""

    @property
    def current_A(self) -> float:
        """Current through the Peltier element now, A; positive heats."""

    def advance_to(self, time_s: float) -> None:
        """Run physics and due events up to `time_s`; ignore a time that has passed already."""

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        """Call `callback(time_s)` when the plant has reached `time_s`; at the same time, in the order of the calls."""

    def set_current_A(self, current_A: float, /) -> None:
        """Send this current through the Peltier element from now on, A; positive heats."""

    def read_temperature_degC(self) -> float:
        """Return the thermometer's reading with its noise, degC; nan if the sensor is open."""

    def sink_temperature_degC(self) -> float:
        """Return the temperature of the heat sink, degC."""

    def read_resistance_ohm(self, test_current_A: float, /) -> float:
        """Return the resistance at the ohmmeter's input with its noise, ohm; inf if the film is open."""

    def read_voltage_V(self) -> float:
        """Return the voltage at the meter's input with its noise, V; 0 if no detector is there."""

    def set_test_current_A(self, test_current_A: float, /) -> None:
        """Send the ohmmeter's test current through the film from now on, A."""


class Instrument:
    """An instrument at the far end of a serial line: cuts what arrives into lines, keeps replies until they are due.

    byte_s: time of one character on the wire, s; 0 takes no time. An emulator takes its lines in `_take_line` and puts
    its replies on the wire with `_send`.
    """

    ENDS: ClassVar[tuple[bytes, ...]] = (b"\r", b"\n")  # characters that each end a line
    LONGEST_PARTIAL: ClassVar[int] = 2048  # characters that are kept of a line without an end

    def __init__(self, plant: Plant, *, byte_s: float, start_s: float) -> None:
        self._plant = plant
        self._byte_s = byte_s
        self._now_s = start_s
        self._partial = b""
        self._replies: deque[tuple[float, bytes]] = deque()
        self._receiving_until_s = self._sending_until_s = start_s

    def receive(self, data: bytes, time_s: float) -> None:
        """Take bytes that the host has written at `time_s`; they arrive here as fast as the baud rate allows."""
        begin_s = max(time_s, self._receiving_until_s)
        already, data = len(self._partial), self._partial + data
        one_end, *others = self.ENDS
        for end in others:
            data = data.replace(end, one_end)
        *lines, rest = data.split(one_end)
        for line in lines:
            begin_s += (len(line) + 1 - already) * self._byte_s
            already = 0
            self._take_line(line, begin_s)
        self._receiving_until_s = begin_s + (len(rest) - already) * self._byte_s
        self._partial = rest[-self.LONGEST_PARTIAL :]

    def transmit(self, time_s: float) -> bytes:
        """Run the plant to `time_s` and return the bytes that have reached the host by then, each once."""
        self._plant.advance_to(time_s)
        replies = self._replies
        if not replies or replies[0][0] > time_s:
            return b""
        data = replies.popleft()[1]
        while replies and replies[0][0] <= time_s:
            data += replies.popleft()[1]
        return data

    def next_transmit_s(self) -> float | None:
        """Return when the next bytes are expected at the host, s; None if nothing is under way.

        They may come later (a meter that changes its range measures again), never earlier.
        """
        return self._replies[0][0] if self._replies else self._next_reply_s()

    def _send(self, data: bytes, begin_s: float) -> None:
        """Begin to send at `begin_s`, or when the reply before has been sent."""
        self._sending_until_s = max(begin_s, self._sending_until_s) + len(data) * self._byte_s
        self._replies.append((self._sending_until_s, data))

    def _take_line(self, line: bytes, arrival_s: float) -> None:
        """Take a line without its end, which arrives at `arrival_s`; it may be empty."""
        raise NotImplementedError

    def _next_reply_s(self) -> float | None:
        """Return when the work under way will have a reply, s; None if there is none."""
        raise NotImplementedError


# ---- what emulated controllers share -----------------------------------------------------------------

TICK_S = 0.1  # of the control loops (no maker says; assumed)


class Regulator:
    """The PID law inside a temperature controller, with a ramped nominal value, ten times a second.

        e_k = nominal_k - T_k
        u_k = Kp (e_k + 1/Ti sum e dt) - Kp Td dT/dt          in % of the current limit, kept within +-100
        nominal_k moves towards the target by at most ramp dt a step

    Kp in %/degC, Ti and Td in s, as parameters 3010 to 3012 of the Meerstetter family (5136AL). No maker publishes the
    law; this is the textbook one. The derivative acts on the measurement, behind a first-order filter whose pole is the
    damping (3013). The integrator holds while the output is at its bound and the error would drive it further.
    """

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget everything: the next step ramps from the temperature that it is given."""
        self.nominal_degC = nan
        self.output_percent = 0.0
        self._integral_percent = 0.0
        self._slope_K_per_s = 0.0
        self._last_degC = nan

    def step(
        self,
        target_degC: float,
        temperature_degC: float,
        *,
        gain_percent_per_K: float,
        integral_time_s: float,
        derivative_time_s: float,
        ramp_K_per_s: float = 0.0,
        damping: float = 0.3,
        lowest_percent: float = -100.0,
    ) -> float:
        """Return the output after `TICK_S`, `lowest_percent` (0 for a heater) to 100 % of the current limit."""
        if isnan(self.nominal_degC):
            self.nominal_degC = temperature_degC
        distance_K = target_degC - self.nominal_degC
        if ramp_K_per_s > 0.0 and abs(distance_K) > ramp_K_per_s * TICK_S:
            self.nominal_degC += copysign(ramp_K_per_s * TICK_S, distance_K)
        else:
            self.nominal_degC = target_degC
        if not isnan(self._last_degC):
            slope_K_per_s = (temperature_degC - self._last_degC) / TICK_S
            self._slope_K_per_s += (1.0 - damping) * (slope_K_per_s - self._slope_K_per_s)
        self._last_degC = temperature_degC
        error_K = self.nominal_degC - temperature_degC
        increment = gain_percent_per_K * error_K * TICK_S / integral_time_s if integral_time_s > 0.0 else 0.0
        fixed = gain_percent_per_K * (error_K - derivative_time_s * self._slope_K_per_s)
        wanted = fixed + self._integral_percent + increment
        output = min(100.0, max(lowest_percent, wanted))
        if wanted == output or (wanted > output) != (increment > 0.0):
            self._integral_percent = min(100.0, max(lowest_percent, self._integral_percent + increment))
        self.output_percent = output
        return output


class Ticking:
    """Part of an emulated controller that runs its control loop every `TICK_S` of the plant's time."""

    _plant: Plant
    _now_s: float

    def _start_ticking(self, start_s: float) -> None:
        self._ticks, self._start_s = 0, start_s
        self._plant.schedule(start_s + TICK_S, self._tick)

    def _tick(self, time_s: float) -> None:
        self._ticks += 1
        self._now_s = time_s
        self._plant.schedule(self._start_s + (self._ticks + 1) * TICK_S, self._tick)
        self._control()

    def _control(self) -> None:
        """Measure, judge, and drive the output, at `_now_s`."""
        raise NotImplementedError


# ---- emulators by name ------------------------------------------------------------------------------

# module and class in sim.instruments by the driver's name; only the one that is asked for is imported
EMULATORS = {
    "hp34401a": ("multimeters", "Hp34401A"),
    "keithley2000": ("multimeters", "Keithley2000"),
    "keithley2400": ("source_meters", "Keithley2400"),
    "keithley2450": ("source_meters", "Keithley2450"),
    "lakeshore": ("lakeshore", "LakeShore"),
    "meerstetter": ("meerstetter", "MeerstetterTec"),
    "srs_ldc500": ("srs_ldc500", "SrsLdc500"),
    "tclab": ("tclab", "TcLab"),
    "te_technology": ("te_technology", "TeTechnology"),
}


def emulated(name: str, plant: Plant, start_s: float = 0.0, **options: Any) -> Instrument:
    """Return the emulator for a driver's name on a plant; options go to it. KeyError for an unknown name."""
    return cast(Instrument, _emulator(name)(plant, start_s=start_s, **options))


def emulator_options(name: str) -> set[str]:
    """Return the names of the options that an emulator has."""
    return set(signature(_emulator(name)).parameters) - {"plant", "start_s"}


def _emulator(name: str) -> Any:
    module, kind = EMULATORS[name]
    return getattr(import_module(f"sim.instruments.{module}"), kind)
