"""What the instrument tests share: a still world, a virtual clock, and simulated ports with clean-up."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from rig.core.clock import VirtualClock
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument
from tests.rig.drivers.still_plant import StillPlant


@pytest.fixture
def plant() -> StillPlant:
    return StillPlant()


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def attach(clock: VirtualClock) -> Iterator[Callable[[Instrument], str]]:
    """Put an instrument behind a `sim://` port of its own; it is pulled out when the test ends."""
    names: list[str] = []

    def put(instrument: Instrument) -> str:
        names.append(f"test-{len(names)}")
        return protocol_sim.register(names[-1], instrument, clock)

    yield put
    for name in names:
        protocol_sim.unregister(name)
