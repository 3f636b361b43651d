"""A bench as an ophyd-async device, for Bluesky. Needs ophyd-async[pva] and bluesky; peltier-rig need not be installed.

    python bench_ophyd.py RIG: 30 35      scans the bench of `peltier epics` with prefix "RIG" over these temperatures

`set` holds a temperature and is done when it has been within `tolerance_K` for `settle_s`; the hold goes on until the
next one, or until it is stopped.
The records are those of `peltier epics` with [epics] write = true.
"""

from __future__ import annotations

import asyncio
import sys
import time

import bluesky.plans as plans
from bluesky import RunEngine
from ophyd_async.core import AsyncStatus, StandardReadable, init_devices, observe_value
from ophyd_async.core import StandardReadableFormat as Format
from ophyd_async.epics.core import epics_signal_r, epics_signal_rw, epics_signal_w

WAITING = ("queued", "running")


class Bench(StandardReadable):
    """prefix: the records' with its colon, as in "pva://RIG:". hold_s: the longest that one temperature is held."""

    def __init__(
        self, prefix: str, name: str = "", tolerance_K: float = 0.1, settle_s: float = 5.0, hold_s: float = 3600
    ):
        with self.add_children_as_readables(Format.HINTED_SIGNAL):
            self.temperature = epics_signal_r(float, f"{prefix}TEMPERATURE")
            self.resistance = epics_signal_r(float, f"{prefix}RESISTANCE")
        with self.add_children_as_readables():
            self.current = epics_signal_r(float, f"{prefix}CURRENT")
            self.quality = epics_signal_r(str, f"{prefix}QUALITY")
        self.wanted = epics_signal_rw(float, f"{prefix}HOLD:TEMPERATURE")
        self.lasts = epics_signal_rw(float, f"{prefix}HOLD:DURATION")
        # writes to these return when the daemon has answered
        self.start = epics_signal_w(bool, f"{prefix}HOLD:START")
        self.cancel = epics_signal_w(bool, f"{prefix}COMMAND:CANCEL")
        self.stop_now = epics_signal_w(bool, f"{prefix}STOP")
        self.job = epics_signal_r(str, f"{prefix}COMMAND:JOB_STATE")
        self.result = epics_signal_r(str, f"{prefix}COMMAND:RESULT")
        self.tolerance_K, self.settle_s, self.hold_s = tolerance_K, settle_s, hold_s
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def set(self, degC: float) -> None:
        """Hold a temperature; done when it is there. Raises where the bench refuses it or ends the hold."""
        for signal, value in ((self.wanted, degC), (self.lasts, self.hold_s)):
            await signal.set(value)
            if await signal.get_value() != value:  # the record keeps its old value, with an alarm
                raise ValueError(f"{signal.source}: {value:g} is beyond the bench's limits")
        await self._end_hold()
        await self.start.set(True)
        if await self.job.get_value() not in WAITING:
            raise RuntimeError(await self.result.get_value())
        there_since_s: float | None = None
        async for value in observe_value(self.temperature, done_timeout=self.hold_s):
            if await self.job.get_value() not in WAITING:
                raise RuntimeError("the bench has ended the hold; its page tells why")
            if abs(value - degC) > self.tolerance_K:
                there_since_s = None
            elif there_since_s is None:
                there_since_s = time.monotonic()
            elif time.monotonic() - there_since_s >= self.settle_s:
                return

    async def stop(self, success: bool = True) -> None:
        """End the hold, the output off, as Bluesky wants it at a pause and at a plan's end whatever that was. Where
        something is wrong (success False) it is STOP, and the bench is latched until somebody resets it."""
        await (self._end_hold() if success else self.stop_now.set(True))

    @AsyncStatus.wrap
    async def unstage(self) -> None:
        """The scan is over: the hold is ended, the output off."""
        await super().unstage()
        await self._end_hold()

    async def _end_hold(self) -> None:
        """End the hold that was started here, where one goes on."""
        if await self.job.get_value() not in WAITING:
            return
        await self.cancel.set(True)
        while await self.job.get_value() in WAITING:
            await asyncio.sleep(0.05)


def main() -> None:
    prefix, temperatures = sys.argv[1], [float(text) for text in sys.argv[2:]]
    engine = RunEngine()
    with init_devices():
        bench = Bench(f"pva://{prefix}", name="bench")

    def tell(kind: str, document: dict) -> None:
        if kind == "event":
            data = document["data"]
            print(f"{data['bench-temperature']:.2f} degC  {data['bench-resistance']:.1f} ohm", flush=True)
        elif kind == "stop":
            print(f"{document['exit_status']} {document['reason']}", flush=True)

    engine(plans.list_scan([bench], bench, temperatures), tell)


if __name__ == "__main__":
    main()
