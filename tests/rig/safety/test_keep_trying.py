"""A controller without a dead man, deaf to "off": told at once, and tried on by a process that holds the port."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.core.errors import PortHeld
from rig.ports.open import LineSettings, holder, is_still_trying, open_port
from rig.ports.pseudo_terminal import PseudoTerminals
from tests.rig.drivers.disobedient import Disobedient
from tests.rig.small import write_bench

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it is known by its name in /proc")


@pytest.fixture
def deaf(tmp_path: Path) -> Iterator[tuple[Path, Disobedient, str]]:
    """Its configuration, the controller with its power on, and its port."""
    path = write_bench(tmp_path)
    text = path.read_text().replace('driver = "meerstetter"', 'driver = "te_technology"')
    path.write_text(text)
    instruments = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
    controller = Disobedient(instruments["controller"], "deaf")
    controller.instrument.values["power on"] = 1
    controller.begin()
    with PseudoTerminals({**instruments, "controller": controller}) as terminals:
        port = terminals.paths["controller"]
        text = text.replace('port = "sim://"', f'port = "{port}"', 1).replace("sim://", terminals.paths["meter"])
        path.write_text(text.replace('time = "virtual"', 'time = "real"'))
        yield path, controller, port
        pid, _ = holder(port)
        if pid is not None and is_still_trying(pid):
            os.kill(pid, signal.SIGKILL)


def peltier(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "rig", *map(str, words)], capture_output=True, text=True, timeout=60.0)


def test_it_goes_on_and_tells_who_asks(deaf: tuple[Path, Disobedient, str]) -> None:
    path, controller, port = deaf
    done = peltier("off", path)
    assert done.returncode == 11
    assert "OUTPUT NOT CONFIRMED OFF" in done.stderr
    assert "by hand" in done.stderr
    until_s = time.monotonic() + 30.0
    while holder(port)[0] is None and time.monotonic() < until_s:
        time.sleep(0.01)
    with pytest.raises(PortHeld, match="still trying to switch the output off") as held:
        open_port(port, LineSettings())
    assert held.value.exit_status == 75
    pid, _ = holder(port)
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)  # so that it does not get there first
    controller.heal()
    third = peltier("off", path)  # is not locked out; but a hand was asked for, and nobody says "confirmed" any more
    assert controller.values["power on"] == 0
    assert third.returncode == 11
    assert "says now that its output is off" in third.stderr
    assert peltier("off", path).returncode == 0
