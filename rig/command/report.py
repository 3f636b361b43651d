"""peltier report FOLDER [--out DIR]: the report of a run folder, written anew; of one that ended early too.

FOLDER is what `run` or `calibrate` wrote, DIR or DIR.part. report.html and figures/ go there, or to --out DIR. Of a run
that ended before its own rows began, as while it calibrated, the runs inside FOLDER are reported, each in its place.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rig.config.toml_file import shown
from rig.core.faults import fault

if TYPE_CHECKING:
    from rig.records.run_folder import RunRows


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the folder of a run, or of a calibration")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where the report goes; default: FOLDER itself")


def main(options: argparse.Namespace) -> int:
    from rig.records.run_folder import recorded_inside, recorded_run

    inside = recorded_inside(options.folder)
    if not inside:
        run = recorded_run(options.folder)
        print(_written(run, _made(options.out) if options.out is not None else options.folder))
        return 0
    names = ", ".join(run.part.name for run in inside)
    text = f"no run.json: the run ended before its own rows began; reported is what it had recorded until then: {names}"
    print(f"{options.folder}: {text}", file=sys.stderr)
    for run in inside:
        print(_written(run, _made(options.out / run.path.name) if options.out is not None else run.part))
    return 0


def _written(run: RunRows, out: Path) -> Path:
    """Write the page of a run into a folder that is there; return its path. Raises Faults."""
    from rig.report.run import write_run_report

    try:
        write_run_report(run, out)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise fault(run.part / "run.json", "", f"is not that of a run ({shown(what)}); expected a run folder") from None
    except OSError as error:
        raise fault(out, "", f"cannot be written: {error.strerror or error}") from None
    return out / "report.html"


def _made(out: Path) -> Path:
    """Make a folder if it is missing. Raises Faults."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise fault(out, "--out", f"cannot be made: {error.strerror or error}") from None
    return out
