"""The report of a run, whatever it was and however it ended: at its end, and anew by `peltier report FOLDER`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from rig.records.run_folder import RunFolder
from rig.report.run_rows import CALIBRATION, LAW, RunRows, ended_early, inner_runs, live_run, recorded_run


def write_run_report(run: RunRows, out: Path) -> None:
    """report.html and figures/ of a run, in a folder that is there. Raises Faults where its rows cannot be read."""
    what = str(run.document["start"]["what"])
    inner = inner_runs(run.part, run.document["start"]["settings"])
    if ended_early(run):
        from rig.report.ended import write_ended_report

        write_ended_report(run, out, inner)
    elif what == CALIBRATION:
        from rig.report.calibration import write_calibration_report

        write_calibration_report(run, out)
    elif what.startswith(LAW):
        from rig.report.tracking import write_tracking_report

        write_tracking_report(run, out, inner)
    else:
        from rig.report.profile import write_profile_report

        write_profile_report(run, out)


def write_missing_reports(part: Path) -> None:
    """Those of the runs in a folder that ended early: its own, and those of the runs inside it. Never raises an
    Exception: what cannot be read has none."""
    folders = [part]
    with suppress(OSError):
        folders = [*part.glob("*.part"), part]
    for folder in folders:
        with suppress(Exception):
            if (folder / "run.json").is_file() and not (folder / "report.html").exists():
                write_run_report(recorded_run(folder), folder)


def write_live_report(folder: RunFolder) -> None:
    """The same of a run that this process has just recorded, in its own folder."""
    write_run_report(live_run(folder), folder.part)
