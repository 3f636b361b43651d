"""Our drivers on simulators that others wrote: PyVISA-sim on a pseudo-terminal, and sciglob's TETech 1090.

(lewis's bath is in test_own_driver.py. Simulators that know neither `;` nor `*ESE` cannot answer the SCPI drivers'
questions, which carry their proof in the same line.)
"""

from __future__ import annotations

import os
import pty
import threading
import tty
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rig.core.clock import RealClock, VirtualClock
from rig.core.errors import Refused, TimedOut
from rig.drivers.meerstetter import MecomLink
from rig.drivers.registry import open_controller
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Transport
from sim.instruments.instrument import Instrument
from tests.rig.drivers.far_ends import Answering

# worked bytes of the TC-36-25 manual, Appendix C p. 42 to 50, and the fence's; PyVISA-sim keeps the ends apart
DEVICE = """
spec: "1.1"
devices:
  tec:
    eom:
      ASRL INSTR:
        q: "\\r"
        r: "^"
    dialogues:
{dialogues}
resources:
  ASRL1::INSTR:
    device: tec
"""


def summed(body: str) -> str:
    return f"*{body}{sum(body.encode()) & 0xFF:02x}"


def dialogue(question: str, answer: str) -> str:
    return f'      - q: "{summed(question)}"\n        r: "{summed(answer)}"'


def te_device(tmp_path: Path) -> Path:
    """25 degC, in degC, sensor type 3, alarms none, power off; the fences that count from 2 on."""
    said = {"01": "000009c4", "43": "00000003", "4b": "00000001", "05": "00000000", "46": "00000000"}
    lines = [dialogue(f"00{code}00000000", answer) for code, answer in said.items()]
    lines.append(dialogue("003400000000", "00000000"))
    lines += [dialogue(f"0025{count:08x}", f"{count:08x}") for count in range(2, 60)]
    path = tmp_path / "tec.yaml"
    path.write_text(DEVICE.format(dialogues="\n".join(lines)), encoding="utf-8")
    return path


@contextmanager
def on_a_terminal(session: Any) -> Iterator[str]:
    """Bytes from a pseudo-terminal to a PyVISA session and back: the terminal's path."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    stop = threading.Event()

    def pump() -> None:
        import select

        while not stop.is_set():
            if select.select([master], [], [], 0.02)[0]:
                for request in os.read(master, 4096).split(b"\r")[:-1]:
                    session.write_raw(request + b"\r")
                    os.write(master, session.read_raw())

    thread = threading.Thread(target=pump)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        stop.set()
        thread.join()
        os.close(master)
        os.close(slave)


def test_te_technology_on_pyvisa_sim(tmp_path: Path) -> None:
    pytest.importorskip("pyvisa_sim", reason="PyVISA-sim is not installed")
    pyvisa = pytest.importorskip("pyvisa", reason="PyVISA is not installed")
    manager = pyvisa.ResourceManager(f"{te_device(tmp_path)}@sim")
    session = manager.open_resource("ASRL1::INSTR", read_termination="^", write_termination="")
    with on_a_terminal(session) as path:
        controller = open_controller("te_technology", path, RealClock(), drain_s=0.05, first_token=1)
        assert controller.identify().model == "TC-36-25 RS232"
        assert controller.read_temperature().value == 25.0
        status = controller.status()
        assert (status.output_is_on, status.is_error) == (False, False)
        controller.close()
    session.close()
    manager.close()


class Sciglob1090(Answering):
    """sciglob's own TETech 1090, behind our port. It answers every question with sequence number 0."""

    def __init__(self) -> None:
        super().__init__()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            module = pytest.importorskip(
                "sciglob.devices.temperature_controller", reason="sciglob is not installed", exc_type=ImportError
            )
        self._responder = module._Simulated1090Responder(object_temp=19.6, device_type=1090)

    def receive(self, data: bytes, time_s: float) -> None:
        answer = self._responder(data)
        if answer is not None:
            self.answer(time_s + 0.005, answer.encode())


def test_mecom_on_sciglobs_controller(attach: Callable[[Instrument], str], clock: VirtualClock) -> None:
    address = attach(Sciglob1090())

    def link() -> MecomLink:
        """One whose next question has the number 0, the only one that is answered."""
        return MecomLink(Transport(open_port(address, LineSettings()), clock), first_token=0xFFFF)  # type: ignore[arg-type]

    first = link()
    assert first.read_int(100) == 1090
    with pytest.raises(TimedOut):  # a right answer with another question's number is none
        first.read_float(1000)
    first.transport.close()
    for action in (
        lambda one: one.read_float(1000) == pytest.approx(19.6),
        lambda one: one.write_float(3000, 31.5) is None,
        lambda one: one.read_float(3000) == 31.5,
    ):
        one = link()
        assert action(one)
        one.transport.close()
    one = link()
    with pytest.raises(Refused):
        one.read_float(1234)
