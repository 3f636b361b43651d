"""Keithley 2000 multimeter as an ohmmeter, byte by byte: bytes and times in, bytes and times out.

Sources: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63; the command set as PyMeasure and QCoDeS use it.
NOT verified on an instrument: test currents, overhead times, digits of a reading (all are parameters).

A command acts `command_s` after its terminator (CR, LF or both) has arrived. A reading integrates NPLC line
periods and samples the film in the middle; `overhead_s` later it is there. Commands wait while a query
waits for its reading. With autorange a reading beyond 120 % or below 10 % of the range is thrown away, and
the next range measures again. The test current flows as long as a resistance function is chosen. ^C and ^X
abort, and discard what is pending. Other functions than resistance can be chosen and set, and read 0.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isinf, isnan

from sim.instruments.instrument import Plant
from sim.instruments.keithley2000_commands import FUNCTIONS, default_settings, define_commands
from sim.instruments.scpi import Call, CommandTree, ScpiError


@dataclass(frozen=True, slots=True)
class Range:
    """A resistance range: full scale, ohm, and its fixed test current, A."""

    full_scale_ohm: float
    test_current_A: float


# not verified on an instrument
RANGES = (
    Range(100.0, 1e-3),
    Range(1e3, 1e-3),
    Range(1e4, 1e-4),
    Range(1e5, 1e-5),
    Range(1e6, 1e-5),
    Range(1e7, 0.7e-6),
    Range(1e8, 0.7e-6),
)
OVERFLOW_TEXT = "+9.90000000E+37"
NAN_TEXT = "+9.91000000E+37"
OVERRANGE, UNDERRANGE = 1.2, 0.1
QUEUE_LENGTH = 10
ABORTS = (b"\x03", b"\x18")


class Keithley2000:
    """The meter.

    baudrate: of the line, 1/s; inf takes no time. line_frequency_Hz: NPLC counts its periods.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        ranges: Sequence[Range] = RANGES,
        serial_number: str = "1234567",
        revision: str = "A20  /A02",
        baudrate: float = 19200.0,
        terminator: bytes = b"\n",
        command_s: float = 0.002,
        overhead_s: float = 0.004,
        line_frequency_Hz: float = 50.0,
        start_s: float = 0.0,
    ) -> None:
        self._plant = plant
        self._ranges = ranges
        self._byte_s = 10.0 / baudrate
        self._terminator = terminator
        self._command_s, self._overhead_s = command_s, overhead_s
        self._line_period_s = 1.0 / line_frequency_Hz
        self.identity = f"KEITHLEY INSTRUMENTS INC.,MODEL 2000,{serial_number},{revision}"
        # the line
        self._partial = b""
        self._messages: deque[tuple[float, str]] = deque()
        self._replies: deque[tuple[float, bytes]] = deque()
        self._receiving_until_s = self._sending_until_s = start_s
        # the message at work
        self._calls: deque[Call] = deque()
        self._answers: list[str] = []
        self._waiting = False
        self._free_s = start_s
        # the measurement
        self._now_s = start_s
        self._sample_s = inf
        self._ready_s = start_s
        self._wanted: list[str] = []
        self._remaining = 0
        self._last = ""
        self._fresh = False
        self.errors: deque[str] = deque()
        self.settings: dict[str, float | str] = {}
        self.function = "VOLT:DC"
        self._range_index = 1
        self._tree = CommandTree()
        define_commands(self._tree, self)
        self.reset()

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`."""
        for character in ABORTS:
            if character in data:
                self._device_clear()
                data = data[data.rfind(character) + 1 :]
        arrival_s = max(time_s, self._receiving_until_s) + len(data) * self._byte_s
        self._receiving_until_s = arrival_s
        lines = (self._partial + data).replace(b"\n", b"\r").split(b"\r")
        self._partial = lines.pop()[-2048:]
        for line in lines:
            if line:
                self._messages.append((arrival_s + self._command_s, line.decode("latin-1")))
                self._plant.schedule(arrival_s + self._command_s, self._work)

    def transmit(self, time_s: float) -> bytes:
        """See `Instrument.transmit`."""
        self._plant.advance_to(time_s)
        replies = self._replies
        if not replies or replies[0][0] > time_s:
            return b""
        data = replies.popleft()[1]
        while replies and replies[0][0] <= time_s:
            data += replies.popleft()[1]
        return data

    def next_transmit_s(self) -> float | None:
        """See `Instrument.next_transmit_s`."""
        if self._replies:
            return self._replies[0][0]
        if self._waiting:
            return self._ready_s
        if self._calls:
            return self._free_s
        return self._messages[0][0] if self._messages else None

    def _device_clear(self) -> None:
        self._partial = b""
        self._messages.clear()
        self._replies.clear()
        self._calls.clear()
        self._answers.clear()
        self.abort()
        self._free_s = self._sending_until_s = self._receiving_until_s = 0.0

    # ---- messages -------------------------------------------------------------------------------

    def _work(self, time_s: float) -> None:
        """Go on with what has arrived, as far as it can be done at `time_s`."""
        self._now_s = time_s
        while not self._waiting:
            if time_s < self._free_s:
                if self._calls or self._messages:
                    self._plant.schedule(self._free_s, self._work)
                return
            if self._calls:
                self._run(self._calls.popleft())
            elif self._messages and self._messages[0][0] <= time_s:
                self._calls.extend(self._tree.parse(self._messages.popleft()[1]))
            else:
                return
            if not (self._calls or self._waiting):
                self._reply(time_s)

    def _run(self, call: Call) -> None:
        try:
            answer = call()
        except ScpiError as error:
            self.push_error(str(error))
            self._calls.clear()
            return
        if answer is not None:
            self._answers.append(answer)

    def _reply(self, time_s: float) -> None:
        if self._answers:
            text = ";".join(self._answers).encode("latin-1") + self._terminator
            self._answers.clear()
            due_s = max(time_s, self._sending_until_s) + len(text) * self._byte_s
            self._sending_until_s = due_s
            self._replies.append((due_s, text))

    def push_error(self, text: str) -> None:
        """Into the error queue; what no longer fits replaces the last entry by an overflow."""
        if len(self.errors) < QUEUE_LENGTH:
            self.errors.append(text)
        else:
            self.errors[-1] = '350,"Queue Overflow"'

    # ---- measuring ------------------------------------------------------------------------------

    @property
    def measures_resistance(self) -> bool:
        """Whether a resistance function is chosen."""
        return self.function in ("RES", "FRES")

    @property
    def full_scale_ohm(self) -> float:
        """Full scale of the resistance range in use."""
        return self._ranges[self._range_index].full_scale_ohm

    def choose_range(self, resistance_ohm: float) -> None:
        """The lowest range that still shows `resistance_ohm`; the plant is told the test current."""
        for index, candidate in enumerate(self._ranges):
            if resistance_ohm <= OVERRANGE * candidate.full_scale_ohm:
                self._use_range(index)
                return
        self._use_range(len(self._ranges) - 1)

    def choose_function(self, function: str) -> None:
        """Measure something else; the test current flows in the resistance functions only."""
        if function not in FUNCTIONS:
            raise ScpiError(-224, "Illegal parameter value")
        self.function = function
        self._use_range(self._range_index)

    def _use_range(self, index: int) -> None:
        self._range_index = index
        current_A = self._ranges[index].test_current_A if self.measures_resistance else 0.0
        self._plant.set_test_current_A(current_A)

    @property
    def measuring(self) -> bool:
        """Whether a measurement is on its way."""
        return self._remaining > 0

    def initiate(self, count: int = 1) -> None:
        """Begin `count` readings."""
        self.abort()
        self._remaining = count
        self._wanted = []
        self._aperture(self._now_s + float(self.settings["TRIG:DEL"]))

    def read(self, count: int) -> None:
        """`READ?`: begin `count` readings, and let the message wait for them."""
        self.initiate(count)
        self._waiting = True

    def fetch(self, fresh: bool) -> str | None:
        """The last reading, after those that are on their way; `fresh`: one that was not given out before."""
        if self.measuring or (fresh and not self._fresh) or not self._last:
            if not self.measuring:
                self.initiate()
            self._waiting = True
            return None
        self._fresh = False
        return self._last

    def abort(self) -> None:
        """Back to idle, without a reading."""
        self._remaining = 0
        self._waiting = False
        self._sample_s = inf

    def _aperture(self, begin_s: float) -> None:
        """Integrate from `begin_s`."""
        aperture_s = float(self.settings[self.function + ":NPLC"]) * self._line_period_s
        self._sample_s = begin_s + 0.5 * aperture_s
        self._ready_s = begin_s + aperture_s + self._overhead_s
        self._plant.schedule(self._sample_s, self._sample)

    def _sample(self, time_s: float) -> None:
        if time_s < self._sample_s:  # of a measurement that was aborted
            return
        self._sample_s = inf
        text = self._digitize()
        if not text:  # another range
            self._aperture(self._ready_s)
            return
        self._wanted.append(text)
        self._remaining -= 1
        if self._remaining:
            self._aperture(self._ready_s + float(self.settings["TRIG:DEL"]))
            return
        self._last, self._fresh = ",".join(self._wanted), True
        self._free_s = self._ready_s
        if self._waiting:
            self._waiting = False
            self._fresh = False
            self._answers.append(self._last)
            if not self._calls:
                self._reply(self._ready_s)
        self._work(time_s)

    def _digitize(self) -> str:
        """The film's resistance as text; empty where autorange has changed the range."""
        if not self.measures_resistance:
            return "+0.00000000E+00"
        now = self._ranges[self._range_index]
        value_ohm = self._plant.read_resistance_ohm(now.test_current_A)
        if isnan(value_ohm):
            return NAN_TEXT
        if self.settings[self.function + ":RANG:AUTO"]:
            if value_ohm > OVERRANGE * now.full_scale_ohm and self._range_index + 1 < len(self._ranges):
                self._use_range(self._range_index + 1)
                return ""
            if abs(value_ohm) < UNDERRANGE * now.full_scale_ohm and self._range_index > 0:
                self._use_range(self._range_index - 1)
                return ""
        if isinf(value_ohm) or abs(value_ohm) > OVERRANGE * now.full_scale_ohm:
            return OVERFLOW_TEXT if value_ohm > 0 else "-" + OVERFLOW_TEXT[1:]
        return "%+.8E" % value_ohm  # noqa: UP031 - half the time of an f-string

    # ---- settings -------------------------------------------------------------------------------

    def reset(self) -> None:
        """`*RST`: DC volts, autorange, NPLC 1, one reading a trigger; the error queue stays."""
        self.abort()
        self.settings = default_settings()
        self._range_index = min(1, len(self._ranges) - 1)
        self.choose_function("VOLT:DC")

    def configure(self, function: str) -> None:
        """`CONFigure`: that function's settings at their defaults, and one reading a trigger."""
        self.abort()
        defaults: Mapping[str, float | str] = default_settings()
        for name, value in defaults.items():
            if name.startswith((function + ":", "TRIG:")):
                self.settings[name] = value
        if function in ("RES", "FRES"):
            self._range_index = min(1, len(self._ranges) - 1)
        self.choose_function(function)
