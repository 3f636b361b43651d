"""Measured records: how well what a diagnosis finds predicts rows that no fit has seen, beside what was asked.

    ./peltier benchmark measured --data DIR [--only PART,...]

DIR holds the records (VO2 films, runs of one Peltier plate, two-heater boards, a lamp). Each is diagnosed as it is, as
the command does; the error is that of the extended model, run as `predict --initial fitted` runs it: what belongs to a
record is fitted to its first 30 s.

film    the two single loops: held-out blocks that only measure, all held-out blocks, readings left out, verdict
pair    one run of the plate to another
steps   random steps of a heater, first half to second, at 1 s and thinned to 4 s: the same names
later   one board on two days
lamp    a lamp on a plate: nothing in the catalogue is the cause
sink    a heater whose far side warms up, one run to another
board   two heaters, the second as an input, one record to another
ovens   four runs of an oven as one, its room logged
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
import numpy as np  # noqa: E402 - numpy reads these where it is imported

from benchmarks._harness import options  # noqa: E402
from rig.analysis.diagnosed import Asked, diagnosed  # noqa: E402
from rig.records.record import Record  # noqa: E402
from rig.records.record_file import ColumnMapping, read_record  # noqa: E402
from sim.inference.gain import rms  # noqa: E402
from sim.inference.joint.held_out import errors_in  # noqa: E402

if TYPE_CHECKING:
    from sim.diagnosis.result import Diagnosis
    from sim.inference.joint.likelihood import Fit

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


def film(data: Path) -> None:
    for name in ("vo2_film_small_gap_raw.tsv", "vo2_film_major_loop.tsv"):
        began = time.perf_counter()
        found = diagnosed([read(data / name)])[0]
        told(name, "0.02", found, "resistance_dec", began)
        print(f"{'':<44}{every_block(found, found.fit, 'resistance_dec'):>9.4g}  asked 0.02    in all held-out blocks")
        left = sum("neighbours" in out.rule for out in found.record.left_out)
        print(f"{'':<44}{left:>9d}  asked 2       readings left out", flush=True)


def one_to_another(data: Path, one: str, other: str, columns: Sequence[str], plate: Any, asked: str) -> None:
    began = time.perf_counter()
    first, second = (read(data / name, columns) for name in (one, other))
    found = diagnosed([first], Asked(plate=plate), [second])[0]
    told(f"{Path(one).stem} to {Path(other).stem}", asked, found, "temperature_K", began)


def steps(data: Path) -> None:
    whole = read(data / "heater_random_steps.csv", STEPS)
    half = whole["time_s"].size // 2
    for stride in (1, 4):
        began = time.perf_counter()
        first, second = part(whole, slice(0, half, stride)), part(whole, slice(half, None, stride))
        found = diagnosed([first], Asked(plate="heater"), [second])[0]
        told(f"heater_random_steps, each {stride} s", "1.3 K", found, "temperature_K", began)


def lamp(data: Path) -> None:
    began = time.perf_counter()
    found = diagnosed([read(data / "lamp_heating.csv", LAMP)])[0]
    told("lamp_heating", "1.6 K", found, "temperature_K", began)
    for candidate in found.candidates[:1]:
        error_K = every_block(found, candidate.fit, "temperature_K")
        print(f"{'':<44}{error_K:>9.4g}  asked 1.65 K  not named, in all held-out blocks", flush=True)


def ovens(data: Path) -> None:
    began = time.perf_counter()
    found = diagnosed([read(data / f"tune{number}.csv", TUNE) for number in range(22, 26)], Asked(plate="heater"))[0]
    told("tune22 to tune25 as one", "0.10 K", found, "temperature_K", began)


PARTS: dict[str, Callable[[Path], None]] = {
    "film": film,
    "pair": lambda data: one_to_another(data, "peltier_80510.csv", "peltier_8052.csv", PLATE, None, "0.60 K"),
    "steps": steps,
    "later": lambda data: one_to_another(
        data, "heater_two_channels.txt", "heater_two_channels_later.txt", BOARD, "heater", "0.68 K"
    ),
    "lamp": lamp,
    "sink": lambda data: one_to_another(data, "tec_run2_1s.csv", "tec_run12.csv", TEC, "heater", "0.16 K"),
    "board": lambda data: one_to_another(data, "tclab_train.csv", "tclab_valid.csv", TCLAB, "heater", "0.50 K"),
    "ovens": ovens,
}


def main() -> int:
    asked = options(__doc__, only=tuple(PARTS), data="")
    for name in asked.only:
        PARTS[name](Path(asked.data))
    return 0


if __name__ == "__main__":
    sys.exit(main())
