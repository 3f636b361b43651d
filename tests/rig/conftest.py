"""What tests of the rig share: a still world, a virtual clock, simulated ports, and a run that has ended."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rig.__main__ import main
from rig.core.clock import VirtualClock
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.small import write_bench


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


@pytest.fixture(scope="session")
def _one_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one_run")
    assert main(["run", str(write_bench(folder)), "--out", str(folder / "run"), "--json", str(folder / "r.json")]) == 0
    return folder


@pytest.fixture
def finished_run(_one_run: Path, tmp_path: Path) -> Path:
    """A copy of the folder of a run on the small bench that has come to its end, for tests of what is done with it."""
    return Path(shutil.copytree(_one_run / "run", tmp_path / "run"))
