"""Who answers at a port: each instrument is found by its own driver; nobody is told as such."""

from __future__ import annotations

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Disconnected
from rig.drivers.registry import searches, tries
from rig.ports import protocol_sim
from sim.instruments.instrument import emulated
from tests.rig.drivers.far_ends import Answering
from tests.rig.drivers.still_plant import StillPlant

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
