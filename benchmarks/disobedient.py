"""A controller that does not obey "off": how it ends, and when the current is gone at the bench's end of the wire.

    ./peltier benchmark disobedient [--driver meerstetter] [--fault deaf] [--way stopped] [--json FILE]

Each case is a real `peltier run` under its guard on pseudo-terminals, by a real clock; when its output has been on for
40 s the controller begins not to obey (`tests/rig/drivers/disobedient.py`), and the run is stopped (SIGTERM), or the
process that holds the port is killed (SIGKILL). Its dead man, where it has one, works: every frame that it hears feeds
it.

Asked: exit status 11, or a confirmation that is true (withdrawn where it is not), every time; where there is a dead
man, the current is gone within its time and 1 s of the first "off". A controller without a dead man that is deaf stays
on: there is nothing but the message.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks._harness import kept, options
from benchmarks._killed_run import KilledRuns
from rig.config.configuration import read_configuration
from rig.guard.takeover import end_trying
from rig.ports.open import holder
from tests.rig.drivers.disobedient import FAULTS, Disobedient

DRIVERS = ("meerstetter", "te_technology")
WAYS = {"stopped": signal.SIGTERM, "killed": signal.SIGKILL}
TRIALS = 4
MORE_S = 3.0  # that is waited for beyond the dead man's time and 1 s
KNOWN_S = 40.0  # from the output's coming on until it stops obeying: a pulse is over, a setpoint is held
PULSE_SHARE = 0.25  # as by default: a run begins with a pulse, from which it knows its plate


@dataclass(frozen=True)
class Case:
    """How one went. gone_s: from the first "off" on the wire, None where the current stays. told_s: until the end."""

    driver: str
    fault: str
    way: str
    status: int
    gone_s: float | None
    told_s: float
    flowed_at_the_end: bool
    said: str

    @property
    def believed_wrongly(self) -> bool:
        """Whether it was told to be off while the current flowed."""
        return self.status != 11 and self.flowed_at_the_end


def one(driver: str, fault: str, way: str) -> tuple[Case, float]:
    """`_one`; on a busy computer an emulator may answer too late for a run to begin, hence more trials, each anew."""
    for _ in range(TRIALS - 1):
        try:
            return _one(driver, fault, way)
        except RuntimeError as error:
            print(f"once more: {error}", file=sys.stderr)
    return _one(driver, fault, way)


def _one(driver: str, fault: str, way: str) -> tuple[Case, float]:
    """One case, and the dead man's time (0 for none), s. Raises RuntimeError where the run does not begin."""
    made: list[Disobedient] = []

    def wrapped(controller: Any) -> Disobedient:
        made.append(Disobedient(controller, fault))
        return made[0]

    with tempfile.TemporaryDirectory() as folder, KilledRuns(Path(folder), driver, wrapped, PULSE_SHARE) as runs:
        table = read_configuration(runs.path).content.bench.controller
        dead_man_s = table.dead_man_s if driver == "meerstetter" else 0.0
        process = runs.start()
        pid, _ = holder(runs.port)
        assert pid is not None
        time.sleep(KNOWN_S)
        made[0].begin()
        runs.witness.told_s.clear()
        begin_s = time.monotonic()
        os.kill(process.pid if way == "stopped" else pid, WAYS[way])
        _, err = process.communicate(timeout=120.0)
        end_s, flowed = time.monotonic(), runs.witness.on
        first_off_s = runs.witness.told_s[0] if runs.witness.told_s else begin_s
        while runs.witness.on and time.monotonic() < first_off_s + dead_man_s + 1.0 + MORE_S:
            time.sleep(0.01)
        gone_s = None if runs.witness.on else runs.witness.off_s - first_off_s
        end_trying(holder(runs.port)[0])
        return Case(driver, fault, way, process.returncode, gone_s, end_s - begin_s, flowed, err.strip()), dead_man_s


def verdict(case: Case, dead_man_s: float) -> str:
    """What is not as asked, in words; "as asked" where nothing is."""
    wrong = []
    if case.believed_wrongly:
        wrong.append("believed to be off while the current flowed")
    if dead_man_s and (case.gone_s is None or case.gone_s > dead_man_s + 1.0):
        wrong.append(f"current not gone within {dead_man_s + 1.0:g} s")
    return "; ".join(wrong) or "as asked"


def main() -> int:
    asked = options(__doc__, driver=DRIVERS, fault=tuple(FAULTS), way=tuple(WAYS))
    print(f"{'controller':<15}{'does not obey':<15}{'run is':<9}{'exit':>5}{'current gone':>14}{'told after':>12}   ")
    rows = []
    for driver in asked.driver:
        for fault in asked.fault:
            for way in asked.way:
                case, dead_man_s = one(driver, fault, way)
                gone = f"{case.gone_s:.2f} s" if case.gone_s is not None else "stays"
                found = verdict(case, dead_man_s)
                head = f"{driver:<15}{fault:<15}{way:<9}{case.status:>5}{gone:>14}{case.told_s:>10.2f} s"
                print(f"{head}   {found}", flush=True)
                rows.append({**asdict(case), "dead_man_s": dead_man_s, "verdict": found})
    wrong = sum(row["verdict"] != "as asked" for row in rows)
    what = "exit status 11, or off in truth, and within the dead man's time and 1 s"
    print(f"asked: {what}: {len(rows) - wrong} of {len(rows)}")
    kept(asked.json, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
