"""The report of a plain temperature or current profile."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rig.analysis.score import COUNTED, largest, profile_error, rms
from rig.report.page import facts, section, tiles, write_page
from rig.report.run_figures import courses, kelvin_figure
from rig.report.run_rows import RunRows, drive_label

TITLES = {"current_profile": "{drive} profile"}  # else the kind's own name


def write_profile_report(run: RunRows, out: Path) -> None:
    """report.html of a recorded profile, in `out`."""
    seconds = float(run.column("time_s")[-1])
    numbers = [(str(run.rows), "rows"), (f"{seconds:.0f} s", "duration")]
    _, error = profile_error(run)
    lead = f"{run.rows} rows over {seconds:.0f} s were recorded."
    parts = [section("Courses", courses(run, out))]
    if np.any(np.isfinite(error)):
        numbers += [(kelvin(rms(error)), f"RMS error {COUNTED}"), (kelvin(largest(error)), "the largest error of it")]
        lead = f"The temperature was within {kelvin(rms(error))} RMS of the wanted one {COUNTED}. {lead}"
        parts.append(section("The error", kelvin_figure(out, run)))
    kind = str(run.document["start"]["what"])
    title = TITLES.get(kind, kind.replace("_", " ")).format(drive=drive_label(run)[0])
    write_page(out / "report.html", f"{run.path.name}: {title}", lead, [facts(run), tiles(numbers), *parts])


def kelvin(error_K: float) -> str:
    """A temperature error with its unit."""
    return f"{error_K * 1e3:.0f} mK" if error_K < 1.0 else f"{error_K:.2f} K"
