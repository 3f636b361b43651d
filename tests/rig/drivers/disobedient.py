"""A controller that does not obey: a wrapper around any emulator, good until `begin`.

    deaf           answers as ever, and does not do what "off" says; 0 A and the emergency stop it obeys
    deaf to all    does none of the three
    lying          deaf to all, and says "off, 0 A"
    silent         nothing of the host's arrives any more, and nothing comes back
    replies lost   everything arrives, and nothing comes back
    late status    obeys at once; its status says so `late_s` later

Its dead man works: every frame that arrives feeds it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sim.instruments.meerstetter import READY, RUN, MeerstetterTec
from sim.instruments.srs_ldc500 import SrsLdc500
from sim.instruments.te_technology import TeTechnology
from tests.rig.drivers.far_ends import Wrapped

FAULTS = ("deaf", "deaf to all", "lying", "silent", "replies lost")
OFF_PARAMETERS = {b"VS07DA": b"00000000", b"VSC350": b"00000000"}  # 2010, 50000: only what switches off is ignored
ZERO_PARAMETERS = {b"VSC351": b"00000000", b"VS07D0": b"00000001"}  # 50001 = 0 A, 2000 = the live source


class Disobedient(Wrapped):
    """Wraps `instrument`. late_s: of "late status"."""

    def __init__(self, instrument: Any, fault: str, *, late_s: float = 0.3) -> None:
        super().__init__(instrument)
        self.fault = fault
        self._late_s = late_s
        self.wrong = False
        self._heal: list[Callable[[], object]] = []

    def begin(self) -> None:
        """From now on it does not obey."""
        self.wrong = True
        if self.fault in ("deaf", "deaf to all", "lying"):
            self._deafen(self.fault != "deaf")
        if self.fault == "lying":
            self._lie()
        if self.fault == "late status":
            self._delay_status()

    def heal(self) -> None:
        """It obeys again."""
        self.wrong = False
        while self._heal:
            self._heal.pop()()

    # ---- as an instrument ----------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        if not (self.wrong and self.fault == "silent"):
            super().receive(data, time_s)

    def transmit(self, time_s: float) -> bytes:
        data = super().transmit(time_s)
        return b"" if self.wrong and self.fault in ("silent", "replies lost") else data

    def __getattr__(self, name: str) -> Any:
        return getattr(self.instrument, name)

    # ---- what is wrong with it -----------------------------------------------------------------

    def _replace(self, name: str, with_what: Any) -> None:
        """A method of the emulator, until it is healed."""
        vars(self.instrument)[name] = with_what
        self._heal.append(lambda: vars(self.instrument).pop(name))

    def _deafen(self, to_all: bool) -> None:
        emulator = self.instrument
        if isinstance(emulator, MeerstetterTec):
            ignored = OFF_PARAMETERS | (ZERO_PARAMETERS if to_all else {})
            right = emulator._set

            def set_unless(payload: bytes) -> int:
                return 0 if ignored.get(payload[:6]) == payload[8:] else right(payload)

            self._replace("_set", set_unless)
            if to_all:
                self._replace("_emergency_stop", lambda: None)
        elif isinstance(emulator, TeTechnology):
            write, power = emulator._write, emulator._model.settings

            def write_unless(code: bytes, value: int) -> None:
                if not (value == 0 and any(s.name == "power on" and s.write == code for s in power)):
                    write(code, value)

            self._replace("_write", write_unless)
        elif isinstance(emulator, SrsLdc500):
            switch, values = emulator.switch, emulator.values
            self._replace("switch", lambda on: switch(on) if on else None)
            if to_all:
                drive, wanted_A = emulator.drive, values["TCUR"]

                def drive_on() -> None:
                    values["TCUR"] = wanted_A
                    drive()

                self._replace("drive", drive_on)
        else:
            raise TypeError(f"nobody knows what {type(emulator).__name__} takes for off")

    def _lie(self) -> None:
        """It reads back that it is off, and no current."""
        emulator = self.instrument
        if isinstance(emulator, MeerstetterTec):
            for parameter, value in ((2010, 0), (104, READY), (1020, 0.0)):
                self._measure(parameter, lambda value=value: value)
        elif isinstance(emulator, TeTechnology):
            read = next(s.read for s in emulator._model.settings if s.name == "power on")
            right = emulator._reads[read]
            emulator._reads[read] = lambda: 0
            self._heal.append(lambda: emulator._reads.__setitem__(read, right))
        else:
            raise TypeError(f"nobody knows what {type(emulator).__name__} reads back")

    def _delay_status(self) -> None:
        """Of a Meerstetter controller: 104 follows so much later."""
        emulator = self.instrument
        assert isinstance(emulator, MeerstetterTec)
        seen: list[tuple[float, int]] = [(-1e9, emulator.status)]

        def late() -> int:
            if emulator.status != seen[-1][1]:
                seen.append((emulator._now_s, emulator.status))
            shown = [state for since_s, state in seen if emulator._now_s - since_s >= self._late_s]
            return shown[-1] if emulator.status in (READY, RUN) else emulator.status

        self._measure(104, late)

    def _measure(self, parameter: int, value: Callable[[], float]) -> None:
        emulator = self.instrument
        before = dict(emulator._measured)
        emulator._measured[parameter] = value
        self._heal.append(lambda: (emulator._measured.clear(), emulator._measured.update(before)))
