"""The report of a run, whatever it was and however it ended: at its end, and anew by `peltier report FOLDER`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from rig.records.run_folder import RunFolder, RunRows, live_run, recorded_run


def write_run_report(run: RunRows, out: Path) -> None:
    """Write report.html and figures/ of a run into a folder that is there. Raises Faults if its rows cannot be read."""
    from rig.report.run_pages import write_run_page  # matplotlib, which no run should wait for before it begins

    write_run_page(run, out)


def write_missing_reports(part: Path) -> None:
    """Write the reports of the runs in a folder that ended early, its own and those inside it. Never raises an
    Exception: what cannot be read has no report."""
    folders = [part]
    with suppress(OSError):
        folders = [*part.glob("*.part"), part]
    for folder in folders:
        with suppress(Exception):
            if (folder / "run.json").is_file() and not (folder / "report.html").exists():
                write_run_report(recorded_run(folder), folder)


def write_live_report(folder: RunFolder) -> None:
    """Write the report of a run that this process has just recorded into its own folder."""
    write_run_report(live_run(folder), folder.part)
