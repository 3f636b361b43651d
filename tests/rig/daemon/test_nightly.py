"""The nightly diagnosis: at night, when nothing runs, once; a change is told once, over restarts too."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

from rig.daemon.nightly import Nightly

TABLE = """rig,effect,parameter,named_in,of,since,change,before,after
T,film_lag,tau_s,40,40,2026-09-26T20:00:00+00:00,value,1.99,3.16
T,sensor_lag,tau_s,40,40,,,,
"""


def at(hour: int, day: int = 100) -> time.struct_time:
    return time.struct_time((2026, 4, 10, hour, 0, 0, 4, day, 0))


def writes(out: Path) -> list[str]:
    code = f"import pathlib; p = pathlib.Path({str(out)!r}); p.mkdir(exist_ok=True); "
    return [sys.executable, "-c", code + f"(p / 'effects.csv').write_text({TABLE!r})"]


def test_a_change_is_told_once(tmp_path: Path) -> None:
    told: list[str] = []
    for _ in range(2):
        nightly = Nightly(tmp_path, 3, lambda: True, told.append, lambda: at(3), writes(tmp_path / "trend"))
        assert nightly.due
        assert nightly.once()
        assert not nightly.due
    assert told == ["trend: film_lag tau_s went from 1.99 to 3.16 since 2026-09-26 (trend/report.html)"]


def test_it_is_due_at_night_and_when_nothing_runs(tmp_path: Path) -> None:
    hours = [h for h in range(24) if Nightly(tmp_path, 3, lambda: True, print, lambda h=h: at(h)).due]
    assert hours == [3, 4, 5, 6, 7, 8]
    assert not Nightly(tmp_path, 3, lambda: False, print, lambda: at(3)).due


def test_a_run_ends_it_and_it_is_due_again(tmp_path: Path) -> None:
    idle, mark = threading.Event(), tmp_path / "mark"
    idle.set()
    code = f"import pathlib, time; pathlib.Path({str(mark)!r}).touch(); time.sleep(600)"
    nightly = Nightly(tmp_path, 3, idle.is_set, print, lambda: at(3), [sys.executable, "-c", code])

    def run_begins() -> None:
        while not mark.exists():
            time.sleep(0.05)
        idle.clear()

    threading.Thread(target=run_begins, daemon=True).start()
    assert not nightly.once()
    assert not nightly.due
    idle.set()
    assert nightly.due


def test_what_goes_wrong_is_told(tmp_path: Path) -> None:
    told: list[str] = []
    code = "import sys; print('no run folder', file=sys.stderr); sys.exit(2)"
    Nightly(tmp_path, 3, lambda: True, told.append, lambda: at(3), [sys.executable, "-c", code]).once()
    Nightly(tmp_path, 3, lambda: True, told.append, lambda: at(3), [str(tmp_path / "nothing")]).once()
    assert told[0] == "the nightly diagnosis ended with status 2: no run folder"
    assert "cannot be started" in told[1]


def test_a_disk_that_takes_nothing_ends_no_nights(tmp_path: Path) -> None:
    """A folder stands for the full disk: nothing can be written in its place. The thread goes on, and says so."""
    (tmp_path / "trend" / "told.json").mkdir(parents=True)
    told: list[str] = []
    nightly = Nightly(tmp_path, 3, lambda: True, told.append, lambda: at(3), writes(tmp_path / "trend"))
    assert nightly.once()
    assert told[0].startswith("trend: film_lag tau_s went from 1.99 to 3.16")
    assert told[1].startswith("trend: the list of reported changes cannot be written")
