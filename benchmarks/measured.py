"""Measured records: how well what a diagnosis finds predicts rows that no fit has seen, beside what was asked.

    ./peltier benchmark measured --data DIR [--only PART,...] [--splits 21]

DIR holds the records (VO2 films, runs of one Peltier plate, two-heater boards, a lamp). Each is diagnosed as it is, as
the command does; the error is that of the extended model, run as `predict --initial fitted` runs it: what belongs to a
record is fitted to its first 30 s.

film    the two single loops: held-out blocks that only measure, all held-out blocks, readings left out, verdict
moved   the first of them as it is, and with every reading times 1 + 1e-12 of chance: what hangs on that is luck
pair    one run of the plate to another
joint   any five of its seven runs jointly, the other two predicted from their currents; --splits of the 21
steps   random steps of a heater, first half to second, at 1 s and thinned to 4 s: the same names
later   one board on two days
lamp    a lamp on a plate: nothing in the catalogue is the cause
sink    a heater whose far side warms up, one run to another
board   two heaters, the second as an input, one record to another
ovens   four runs of an oven as one, its room logged
"""

from __future__ import annotations

import argparse
import itertools
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402 - numpy reads these where it is imported

from rig.analysis.diagnosed import Asked, diagnosed  # noqa: E402
from rig.records.record import Record  # noqa: E402
from rig.records.record_file import ColumnMapping, read_record  # noqa: E402
from sim.inference.gain import rms  # noqa: E402
from sim.inference.joint.held_out import errors_in  # noqa: E402

if TYPE_CHECKING:
    from sim.diagnosis.result import Diagnosis
    from sim.inference.joint.likelihood import Fit

SMALL_GAP = "vo2_film_small_gap_raw.tsv"
DRAWS = 12  # of `moved`: the first is the record as it is
RUNS = ("500", "8010", "8020", "8051", "80510", "8052", "8055")
PLATE = ("time_s=t_s|time@s", "temperature_degC=T_C|temp@degC", "current_A=duty|output@duty")
STEPS = ("time_s=t_s", "temperature_degC=T1_C", "current_A=duty1@duty")
BOARD = ("time_s=#1", "temperature_degC=#4@degC", "current_A=#2@percent")
TEC = ("temperature_degC=T_degC", "current_A=out@pwm255")
TCLAB = ("temperature_degC=T1_degC", "current_A=H1_percent@percent", "input_2=H2_percent")
TUNE = ("temperature_degC=oven_c", "current_A=output@pwm255", "ambient_degC=ambient_c")
LAMP = ("temperature_degC=y_C", "current_A=#2@duty")


def read(path: Path, columns: Iterable[str] = ()) -> Record:
    """A record, by --column arguments."""
    return read_record(path, [ColumnMapping.parse(text) for text in columns])


def part(record: Record, rows: slice) -> Record:
    """Some of its rows."""
    return Record({name: values[rows] for name, values in record.columns.items()}, record.source, drive=record.drive)


def told(what: str, asked: str, found: Diagnosis, channel: str, began: float) -> float:
    """A line of the table; the error."""
    own = found.channels[channel]
    assert own is not None
    names = ", ".join(f.name for f in found.findings) or "-"
    better = "".join(f"; not named {'+'.join(c.names)}: {c.rmse_holdout[channel]:.3g}" for c in found.candidates[:1])
    took = time.perf_counter() - began
    print(
        f"{what:<44}{own.rmse_extended:>9.4g}  asked {asked:<8}{found.verdict}: {names}{better} ({took:.0f} s)",
        flush=True,
    )
    return own.rmse_extended


def every_block(found: Diagnosis, fit: Fit, channel: str) -> float:
    """Return the error in all held-out blocks, in those that decide too, of a fit that has not seen them."""
    errors = errors_in(fit, found.record.held_out)[channel]
    return rms(errors[np.isfinite(errors)])


def film(data: Path, _: int) -> None:
    for name in (SMALL_GAP, "vo2_film_major_loop.tsv"):
        began = time.perf_counter()
        found = diagnosed([read(data / name)])[0]
        told(name, "0.02", found, "resistance_dec", began)
        print(f"{'':<44}{every_block(found, found.fit, 'resistance_dec'):>9.4g}  asked 0.02    in all held-out blocks")
        left = sum("neighbours" in out.rule for out in found.record.left_out)
        print(f"{'':<44}{left:>9d}  asked 2       readings left out", flush=True)


def moved(data: Path, _: int) -> None:
    record, errors, of_all = read(data / SMALL_GAP), [], []
    for seed in range(DRAWS):
        by, began = 1e-12 * (seed > 0), time.perf_counter()
        rng = np.random.default_rng(seed)
        columns = {
            name: values if name == "time_s" else values * (1.0 + by * rng.standard_normal(values.size))
            for name, values in record.columns.items()
        }
        found = diagnosed([Record(columns, record.source)])[0]
        errors.append(told(f"the same, readings moved ({seed})", "0.02", found, "resistance_dec", began))
        of_all.append(every_block(found, found.fit, "resistance_dec"))
    for what, values in (("median; least; most", errors), ("the same in all held-out blocks", of_all)):
        figures = "".join(f"{value:>9.4g}" for value in (statistics.median(values), min(values), max(values)))
        print(f"{what:<44}{figures}  {sum(value > 0.02 for value in values)} above what is asked")


def pair(data: Path, _: int) -> None:
    began = time.perf_counter()
    one, other = (read(data / f"peltier_{name}.csv", PLATE) for name in ("80510", "8052"))
    told("peltier_80510 to 8052", "0.60 K", diagnosed([one], holdout=[other])[0], "temperature_K", began)


def joint(data: Path, splits: int) -> None:
    runs = {name: read(data / f"peltier_{name}.csv", PLATE) for name in RUNS}
    every = list(itertools.combinations(runs, 2))
    errors = []
    for held in every[:: max(1, len(every) // splits)][:splits]:
        began = time.perf_counter()
        five = [record for name, record in runs.items() if name not in held]
        found = diagnosed(five, holdout=[runs[name] for name in held])[0]
        errors.append(told(f"peltier: five runs to {' and '.join(held)}", "", found, "temperature_K", began))
    middle, worst = statistics.median(errors), max(errors)
    print(f"{f'median, worst of {len(errors)} splits':<44}{middle:>9.3g}{worst:>9.3g}  asked 1.8, 2.6 K")


def steps(data: Path, _: int) -> None:
    whole = read(data / "heater_random_steps.csv", STEPS)
    half = whole["time_s"].size // 2
    for stride in (1, 4):
        began = time.perf_counter()
        first, second = part(whole, slice(0, half, stride)), part(whole, slice(half, None, stride))
        found = diagnosed([first], Asked(plate="heater"), [second])[0]
        told(f"heater_random_steps, each {stride} s", "1.3 K", found, "temperature_K", began)


def later(data: Path, _: int) -> None:
    began = time.perf_counter()
    one, other = (read(data / f"heater_two_channels{name}.txt", BOARD) for name in ("", "_later"))
    found = diagnosed([one], Asked(plate="heater"), [other])[0]
    told("heater_two_channels to _later", "0.68 K", found, "temperature_K", began)


def lamp(data: Path, _: int) -> None:
    began = time.perf_counter()
    found = diagnosed([read(data / "lamp_heating.csv", LAMP)])[0]
    told("lamp_heating", "1.6 K", found, "temperature_K", began)
    for candidate in found.candidates[:1]:
        error_K = every_block(found, candidate.fit, "temperature_K")
        print(f"{'':<44}{error_K:>9.4g}  asked 1.65 K  not named, in all held-out blocks", flush=True)


def sink(data: Path, _: int) -> None:
    began = time.perf_counter()
    one, other = (read(data / name, TEC) for name in ("tec_run2_1s.csv", "tec_run12.csv"))
    found = diagnosed([one], Asked(plate="heater"), [other])[0]
    told("tec_run2_1s to tec_run12", "0.16 K", found, "temperature_K", began)


def board(data: Path, _: int) -> None:
    began = time.perf_counter()
    one, other = (read(data / f"tclab_{name}.csv", TCLAB) for name in ("train", "valid"))
    found = diagnosed([one], Asked(plate="heater"), [other])[0]
    told("tclab_train to tclab_valid", "0.50 K", found, "temperature_K", began)


def ovens(data: Path, _: int) -> None:
    began = time.perf_counter()
    found = diagnosed([read(data / f"tune{number}.csv", TUNE) for number in range(22, 26)], Asked(plate="heater"))[0]
    told("tune22 to tune25 as one", "0.10 K", found, "temperature_K", began)


PARTS: dict[str, Callable[[Path, int], None]] = {
    "film": film, "moved": moved, "pair": pair, "joint": joint, "steps": steps, "later": later, "lamp": lamp,
    "sink": sink, "board": board, "ovens": ovens,
}  # fmt: skip


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="the folder of the records")
    parser.add_argument("--only", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--splits", type=int, default=21)
    options = parser.parse_args(words)
    for name in options.only.split(","):
        PARTS[name](options.data, options.splits)
    return 0


if __name__ == "__main__":
    sys.exit(main())
