"""Ports and the transport: deadlines, stale bytes, vanished devices, exclusive use; and who answers at a port."""

from __future__ import annotations

import fcntl
import os
import pty
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from rig.core.clock import RealClock, VirtualClock
from rig.core.errors import Corrupt, Disconnected, PortHeld, TimedOut
from rig.drivers.registry import searches, tries
from rig.ports import protocol_sim
from rig.ports.open import LineSettings, open_port
from rig.ports.pseudo_terminal import PseudoTerminals
from rig.ports.transport import Transport
from sim.instruments.instrument import Instrument, emulated
from sim.instruments.multimeters import Keithley2000
from tests.rig.drivers.far_ends import Answering, Conversation
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
LINE = LineSettings(9600)


class Source(Conversation):
    """Sends `pieces`, each at its time, whatever it is told."""

    def __init__(self, *pieces: tuple[float, bytes]) -> None:
        super().__init__([])
        self._replies = list(pieces)

    def receive(self, data: bytes, time_s: float) -> None:
        pass


@pytest.fixture
def connect(attach: Attach, clock: VirtualClock) -> Callable[[Instrument], Transport]:
    return lambda instrument: Transport(open_port(attach(instrument), LINE), clock)


Connect = Callable[[Instrument], Transport]


def test_a_split_line_is_one_line(connect: Connect, clock: VirtualClock) -> None:
    transport = connect(Source((0.1, b"he"), (0.2, b"ll"), (0.3, b"o\nwor"), (0.4, b"ld\n")))
    assert transport.receive_line(b"\n", 1.0) == b"hello"
    assert clock.now_s() == pytest.approx(0.3)
    assert transport.has_more
    assert transport.receive_line(b"\n", 1.0) == b"world"
    assert not transport.has_more


def test_a_trickle_does_not_extend_the_deadline(connect: Connect, clock: VirtualClock) -> None:
    transport = connect(Source(*[(0.09 * step, b"x") for step in range(100)]))
    with pytest.raises(TimedOut, match="bytes of one"):
        transport.receive_line(b"\n", 1.0)
    assert clock.now_s() == pytest.approx(1.0)


def test_no_part_of_a_line_is_returned(connect: Connect) -> None:
    transport = connect(Source((0.1, b"12345"), (0.9, b"67\n")))
    with pytest.raises(TimedOut):
        transport.receive_line(b"\n", 0.5)
    assert transport.receive_line(b"\n", 1.0) == b"1234567"


def test_babble_is_corrupt(connect: Connect) -> None:
    with pytest.raises(Corrupt):
        connect(Source((0.0, b"x" * 5000))).receive_line(b"\n", 1.0)


def test_stale_input_is_thrown_away_before_a_request(connect: Connect, clock: VirtualClock) -> None:
    transport = connect(Source((0.0, b"stale\n"), (0.5, b"fresh\n")))
    clock.sleep_until_s(0.2)
    transport.send(b"?")
    assert transport.stale_bytes == 6
    assert transport.receive_line(b"\n", 1.0) == b"fresh"


def test_a_port_that_is_gone_is_told_in_the_systems_words_once(clock: VirtualClock, tmp_path: Path) -> None:
    gone = tmp_path / "ttyUSB0"
    port = serial.Serial()
    port.port = str(gone)
    with pytest.raises(Disconnected, match=rf"^{gone} \(controller\): cannot be opened: No such file or directory$"):
        Transport(port, clock, f"{gone} (controller)").reopen()


def test_an_unplugged_instrument_is_disconnected(connect: Connect, clock: VirtualClock) -> None:
    source = Source((0.1, b"x\n"))
    transport = connect(source)
    protocol_sim.unregister("test-0")
    for action in (
        lambda: transport.send(b"?"),
        lambda: transport.receive_line(b"\n", 1.0),
        lambda: transport.has_more,
        lambda: transport.drain(),
        lambda: transport.reopen(),
    ):
        with pytest.raises(Disconnected):
            action()
    protocol_sim.register("test-0", source, clock)
    transport.reopen()
    assert transport.receive_line(b"\n", 1.0) == b"x"


@pytest.mark.parametrize(
    "error", [serial.SerialException("gone"), OSError(5, "EIO"), termios.error(5, "EIO"), TypeError("closed")]
)
def test_what_a_vanished_device_raises_is_disconnected(clock: VirtualClock, error: Exception) -> None:
    class Broken:
        timeout: float | None = None
        is_open = True

        @property
        def in_waiting(self) -> int:
            raise error

        def read(self, size: int = 1, /) -> bytes:
            raise error

        def write(self, data: bytes, /) -> int | None:
            raise error

        def open(self) -> None:
            raise error

        def close(self) -> None:
            raise error

    transport = Transport(Broken(), clock)
    for action in (
        lambda: transport.send(b"?"),
        lambda: transport.receive_line(b"\n", 1.0),
        lambda: transport.reopen(),
    ):
        with pytest.raises(Disconnected):
            action()
    transport.close()


def test_a_stuck_line_times_out(clock: VirtualClock) -> None:
    class Stuck(serial.SerialBase):
        in_waiting = 0

        def write(self, data: object, /) -> int:
            raise serial.SerialTimeoutException("Write timeout")

    with pytest.raises(TimedOut):
        Transport(Stuck(), clock).send(b"?")


# ---- sim:// ---------------------------------------------------------------------------------------


def test_sim_port_is_a_pyserial_port(attach: Attach, clock: VirtualClock) -> None:
    port = serial.serial_for_url(attach(Source((0.5, b"abc"), (2.0, b"def"))), timeout=1.0)
    assert isinstance(port, serial.SerialBase)
    assert port.read(10) == b"abc"
    assert clock.now_s() == 1.0
    assert port.read(3) == b"def"
    assert clock.now_s() == 2.0
    assert port.read(1) == b""
    port.timeout = None
    with pytest.raises(serial.SerialException, match="for ever"):
        port.read(1)
    port.close()
    with pytest.raises(serial.SerialException):
        port.read(1)


def test_sim_port_is_held_by_one(attach: Attach) -> None:
    address = attach(Source())
    port = open_port(address, LINE)
    with pytest.raises(PortHeld):
        open_port(address, LINE)
    port.close()
    open_port(address, LINE).close()


def test_sim_port_in_real_time() -> None:
    clock = RealClock()
    now_s = clock.now_s()
    address = protocol_sim.register("real", Source((now_s + 0.05, b"x\n")), clock)
    try:
        transport = Transport(open_port(address, LINE), clock)
        assert transport.receive_line(b"\n", now_s + 1.0) == b"x"
        assert 0.05 <= clock.now_s() - now_s < 0.5
        with pytest.raises(TimedOut):
            transport.receive_line(b"\n", clock.now_s() + 0.02)
    finally:
        protocol_sim.unregister("real")


# ---- real ports -----------------------------------------------------------------------------------


@pytest.mark.parametrize("port", ["/dev/does-not-exist", "nonsense://x", "socket://127.0.0.1:1", "sim://nobody"])
def test_a_port_that_is_not_there(port: str) -> None:
    with pytest.raises(Disconnected, match=port.split("/")[-1]):
        open_port(port, LINE)


def test_a_held_port_says_by_whom() -> None:
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    script = (
        "import serial, sys; port = serial.Serial(sys.argv[1], exclusive=True)\nprint(1, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-c", script, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        with pytest.raises(PortHeld) as held:
            open_port(path, LINE)
        assert held.value.pid == other.pid
        assert path in held.value.command
        assert f"process {other.pid}" in str(held.value)
        assert held.value.exit_status == 75
        other.communicate()
    port = open_port(path, LINE)
    with pytest.raises(BlockingIOError):  # as others find ours
        fcntl.flock(slave, fcntl.LOCK_EX | fcntl.LOCK_NB)
    port.close()
    os.close(master)
    os.close(slave)


def test_a_vanished_pseudo_terminal_is_disconnected() -> None:
    master, slave = pty.openpty()
    transport = Transport(open_port(os.ttyname(slave), LINE), RealClock())
    os.close(slave)
    os.close(master)
    with pytest.raises(Disconnected):
        transport.send(b"?")
    with pytest.raises(Disconnected):
        transport.receive_line(b"\n", time.monotonic() + 1.0)
    transport.close()


# ---- pseudo-terminals -----------------------------------------------------------------------------


PATIENCE_S = 60.0  # on a busy computer


class Echo(Conversation):
    """Sends back what it gets, a while later in its own time."""

    def __init__(self, delay_s: float = 0.1) -> None:
        super().__init__([])
        self._delay_s = delay_s

    def receive(self, data: bytes, time_s: float) -> None:
        self._replies.append((time_s + self._delay_s, data))


@pytest.mark.parametrize(("speed", "delay_s"), [(1.0, 0.1), (1000.0, 2.0 * PATIENCE_S)])
def test_pseudo_terminal_serves_sessions_in_scaled_time(speed: float, delay_s: float) -> None:
    """Not before its delay over the speed; and what at the speed of 1 would take longer than anybody waits arrives."""
    with PseudoTerminals({"a": Echo(), "b": Echo(delay_s)}, speed=speed) as terminals:
        assert set(terminals.paths) == {"a", "b"}
        for _ in range(2):  # one client after another
            transport = Transport(open_port(terminals.paths["b"], LINE), RealClock())
            begin_s = time.monotonic()
            transport.send(b"\x18\x03hello\r")
            assert transport.receive_line(b"\r", begin_s + PATIENCE_S) == b"\x18\x03hello"
            assert time.monotonic() - begin_s >= delay_s / speed
            transport.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "pseudo-terminals"]


def test_pseudo_terminal_hands_over_an_emulators_exception() -> None:
    class Faulty(Echo):
        def receive(self, data: bytes, time_s: float) -> None:
            raise RuntimeError("bug")

    terminals = PseudoTerminals({"a": Faulty()})
    terminals.start()
    with serial.Serial(terminals.paths["a"]) as port:
        port.write(b"x")
        time.sleep(0.1)
    with pytest.raises(RuntimeError, match="bug"):
        terminals.stop()


def test_the_far_end_of_a_terminal_does_not_hold_it() -> None:
    """`peltier emulate` keeps the near end open; another process finds it free, until it is held."""
    ask = "import sys; from rig.ports.open import holder; print(holder(sys.argv[1])[0])"

    def asked(path: str) -> str:
        return subprocess.run([sys.executable, "-c", ask, path], capture_output=True, text=True, check=True).stdout

    with PseudoTerminals({"it": Keithley2000(StillPlant())}) as terminals:
        path = terminals.paths["it"]
        assert asked(path) == "None\n"
        port = open_port(path, LineSettings())
        assert asked(path) == f"{os.getpid()}\n"
        port.close()


SEARCHES = searches("sim://ask")


@pytest.mark.parametrize(("role", "driver", "options"), SEARCHES, ids=lambda value: str(value) if value else "")
def test_each_is_found_by_its_driver(
    role: str, driver: str, options: dict[str, object], plant: StillPlant, clock: VirtualClock
) -> None:
    model = {name: value for name, value in options.items() if name == "model"}
    address = protocol_sim.register("ask", emulated(driver, plant, **model), clock)
    try:
        found = list(tries(address, clock))
        assert found[-1][0] == driver
        identity = found[-1][1]
        assert identity is not None
        assert "48-20" in identity.model or model.get("model") != "tc-48-20"
        assert all(tried.identity is None for tried in found[:-1])
        assert (plant.current_A, plant.test_current_A) == (0.0, 0.0)
    finally:
        protocol_sim.unregister("ask")


def test_nobody(clock: VirtualClock) -> None:
    address = protocol_sim.register("silence", Answering(), clock)
    try:
        said: list[str] = []
        for k, tried in enumerate(tries(address, clock, said.append), start=1):
            assert (tried.identity, tried.came) == (None, None)
            assert said[k - 1] == f"asking as {tried.driver} does ({k} of {len(SEARCHES)})"
        assert len(said) == len(SEARCHES)
        assert clock.now_s() < 60.0
    finally:
        protocol_sim.unregister("silence")
    with pytest.raises(Disconnected):
        next(tries("sim://not-there", clock))


class Saying(Answering):
    """What answers each message with the same bytes."""

    def __init__(self, answer: bytes) -> None:
        super().__init__()
        self._answer = answer

    def receive(self, data: bytes, time_s: float) -> None:
        self.answer(time_s + 0.01, self._answer)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (b"KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02\r", "they end in CR (its terminator)"),
        (b"+1.0E+05", "they have no end at all"),
        (b"\xf8\x80\x00\xfe\x9e\xe6\x18\x80", "no text, as with another baud rate"),
    ],
)
def test_bytes_that_are_not_understood_are_told_from_silence(answer: bytes, says: str, clock: VirtualClock) -> None:
    """A terminator of CR, or another baud rate, made people look for a fault in their cable."""
    address = protocol_sim.register("saying", Saying(answer), clock)
    try:
        came = {tried.driver: tried.came for tried in tries(address, clock)}
        assert says in str(came["keithley2000"])
    finally:
        protocol_sim.unregister("saying")
