"""Whether the error that a diagnosis says of another record is the one that whoever predicts that record gets.

    ./peltier benchmark held_out [--seeds 10] [--first 0] [--data FOLDER]

For each case `peltier diagnose RECORD --holdout OTHER --out MODEL`, then `peltier predict MODEL OTHER --initial fitted`
in another call, from the files alone: the error there over the one that was said, in each channel. Asked: within 5 %,
on 50 simulated cases (`tests/truth.py`: one, two or three hidden effects, none, a film of another kind; --seeds of each
kind) and on the measured records of a folder, where it is there.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rig.__main__ import main as peltier  # noqa: E402
from rig.records.record_file import write_columns  # noqa: E402
from tests.truth import drawn_effects, record  # noqa: E402

KINDS = {"one": 1, "two": 2, "three": 3, "clean": 0, "other_film": 0}  # effects that are hidden
ASKED = 0.05  # relative
DUTY = ("time_s=time@s", "temperature_degC=temp@degC", "current_A=output@duty")
LOGGED = ("time_s=t_s", "temperature_degC=T_C@degC", "current_A=duty@duty")
BOARD = ("time_s=#1", "temperature_degC=#4@degC", "current_A=#2@percent")
MEASURED = (  # record, other record, columns
    ("peltier_80510.csv", "peltier_8052.csv", DUTY),
    ("peltier_8051.csv", "peltier_80510.csv", DUTY),
    ("peltier_8010.csv", "peltier_8020.csv", LOGGED),
    ("heater_two_channels.txt", "heater_two_channels_later.txt", BOARD),
)
ERRORS = {"temperature_K": "rmse_K", "resistance_dec": "rmse_dec"}  # channel of a diagnosis, figure of a prediction
Row = dict[str, Any]


def asked(words: Sequence[object]) -> dict[str, Any]:
    """What a verb answers with --json -. Raises RuntimeError with what it says where it refuses."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = peltier([*map(str, words), "--json", "-"])
    if status != 0:
        raise RuntimeError(err.getvalue().strip())
    return dict(json.loads(out.getvalue()))


def compared(name: str, record: Path, other: Path, columns: Sequence[str] = ()) -> Row:
    """One case: of each channel the error that was said, the one that was got, and both's ratio."""
    typed = [word for column in columns for word in ("--column", column)]
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model.toml"
        said = asked(["diagnose", record, "--holdout", other, "--out", model, *typed])
        got = asked(["predict", model, other, "--initial", "fitted", *typed])
    row: Row = {"name": name, "found": [effect["name"] for effect in said["effects"]], "verdict": said["verdict"]}
    for channel, figure in ERRORS.items():
        own = said["channels"].get(channel)
        if own is not None and got.get(figure) is not None:
            row[channel] = [own["rmse_extended"], got[figure], got[figure] / own["rmse_extended"]]
    return row


def blind(kind: str, seed: int) -> Row:
    """A simulated case with its record of another profile."""
    hidden, film = drawn_effects(seed, KINDS[kind]), "outside" if kind == "other_film" else "class"
    with tempfile.TemporaryDirectory() as folder:
        one, other = Path(folder) / "record.csv", Path(folder) / "other.csv"
        write_columns(one, record(seed, hidden, film))
        write_columns(other, record(seed, hidden, film, profile=seed + 1))
        return {**compared(f"{kind} {seed}", one, other), "hidden": list(hidden)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="of measured records")
    options = parser.parse_args()
    wanted = [(f"{k} {s}", blind, (k, s)) for s in range(options.first, options.first + options.seeds) for k in KINDS]
    for one, other, columns in MEASURED if options.data is not None else ():
        name = f"{one} to {other}"
        wanted.append((name, compared, (name, options.data / one, options.data / other, columns)))
    found: list[Row] = []
    for name, measure, of in wanted:
        try:
            found.append(measure(*of))
        except RuntimeError as error:
            found.append({"name": name, "error": str(error)})
        print(found[-1], flush=True)
    refused = sum("error" in row for row in found)
    ratios = {c: sorted(row[c][2] for row in found if c in row) for c in ERRORS}
    print(f"\n{len(found)} cases, {refused} refused; error got over error said, asked 1 within {ASKED:g}")
    for channel, of_all in ratios.items():
        within = sum(abs(ratio - 1.0) <= ASKED for ratio in of_all)
        ends = f"least {of_all[0]:.9f}, largest {of_all[-1]:.9f}" if of_all else ""
        print(f"{channel:16s} {within} of {len(of_all)} within; {ends}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
