"""The controller's own PID, told setpoints: with the gains it is delivered with, and with those of `peltier tune`.

    ./peltier benchmark own_gains [--seeds N] [--only class|outside] [--driver meerstetter] [--current 4]

Plant, films and target are those of `benchmark tracking`: the film's own resistance over the whole target, in
n = 0.002 decades, law = "instrument_pid". Asked: 0.8 n with the gains of `tune` (1.2 n with gains set by hand).
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._own_plant import SIMULATED_BENCH, behind_the_instruments, noted_phase
from benchmarks._tracked_plant import NOISE_DEC, Plate, TrackedPlant
from benchmarks.tracking import COLD_DEGC, FILMS, HOT_DEGC, course, span

ASKED = 0.8
DELIVERED, TUNED = "as delivered", "by tune"
CONFIGURATION = (
    SIMULATED_BENCH
    + f"""
[limits]
temperature_degC = [10, 95]
current_A = {{current}}
[experiment]
kind = "track_resistance"
target = "target.csv"
law = "instrument_pid"
period_s = 0.1
model = "{{model}}"
[calibration]
temperature_degC = [{COLD_DEGC}, {HOT_DEGC}]
rate_K_per_s = 0.7
minor_loops = 8
dwell_s = 2.0
"""
)


def tracked(case: tuple[str, int, str, float]) -> dict[str, Any]:
    """Calibrate, then run with either gains: RMS and largest error of the film, in n."""
    from rig.__main__ import main

    kind, seed, driver, current_A = case
    times, values = course(*span(FILMS[kind](seed)), seed)
    found: dict[str, Any] = {"film": kind, "seed": seed}
    with tempfile.TemporaryDirectory(prefix="own-gains-") as name:
        folder, path = Path(name), Path(name) / "config.toml"
        lines = [f"{t:.3f},{10.0**y:.8g}" for t, y in zip(times, values, strict=True)]
        (folder / "target.csv").write_text("time_s,target_ohm\n" + "\n".join(lines) + "\n")
        made = behind_the_instruments(lambda start_s: TrackedPlant(Plate(), FILMS[kind](seed), seed, start_s))
        with (
            made as plants,
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()) as err,
        ):
            for what in ("calibrate", DELIVERED, TUNED):
                model = "target.csv" if what == "calibrate" else "calibrate/MODEL.toml"
                text = CONFIGURATION.format(current=current_A, model=model).replace('"meerstetter"', f'"{driver}"')
                path.write_text(text)
                if what == TUNED:
                    path.write_text(text + own_gains(path))
                verb = "calibrate" if what == "calibrate" else "run"
                with noted_phase(lambda n: n == "track") as begin_s:
                    status = main([verb, str(path), "--out", str(folder / what.replace(" ", "_"))])
                if status:
                    found["text"] = f"{what}: {err.getvalue()[-300:]}"
                    break
                if verb == "run":
                    found[what] = error(plants[-1], begin_s[-1], times, values)
    return found


def own_gains(path: Path) -> str:
    """The driver's options that `peltier tune` gives, as a table of the configuration."""
    from rig.__main__ import main

    told = path.with_suffix(".json")
    main(["tune", str(path), "--json", str(told)])
    gains = json.loads(told.read_text())["instrument_pid_gains"]["options"]
    return "[bench.controller.options]\n" + "".join(f"{key} = {value!r}\n" for key, value in gains.items())


def error(plant: TrackedPlant, begin_s: float, times: list[float], values: list[float]) -> tuple[float, float]:
    """RMS and largest, in n, of the film itself over the whole target."""
    time, _, log_ohm = np.array(plant.course).T
    grid = np.arange(0.0, times[-1], 0.05)
    off = np.interp(begin_s + grid, time, log_ohm) - np.interp(grid, times, values)
    return float(np.sqrt(np.mean(off**2))) / NOISE_DEC, float(np.max(np.abs(off))) / NOISE_DEC


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=sorted(FILMS))
    parser.add_argument("--driver", default="meerstetter")
    parser.add_argument("--current", type=float, default=4.0, help="limit, A")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    kinds = [options.only] if options.only else list(FILMS)
    seeds = range(options.first, options.first + options.seeds)
    cases = [(kind, seed, options.driver, options.current) for kind in kinds for seed in seeds]
    with ProcessPoolExecutor(options.workers) as pool:
        found = list(pool.map(tracked, cases))
    print(f"instrument_pid, {options.driver}: errors of the film in n = {NOISE_DEC} decades, RMS (largest)")
    for result in found:
        words = [
            f"{what} {result[what][0]:5.2f} ({result[what][1]:5.2f})" for what in (DELIVERED, TUNED) if what in result
        ]
        print(f"{result['film']:8s} {result['seed']:3d}   {'   '.join(words)}   {result.get('text', '')}")
    good = all("text" not in result for result in found)
    for kind in kinds:
        for what in (DELIVERED, TUNED):
            rms = [result[what][0] for result in found if result["film"] == kind and what in result]
            if rms:
                asked = f"asked {ASKED:g}" if what == TUNED else ""
                print(f"{kind:8s} {what:12s} median {np.median(rms):5.2f}   worst {max(rms):5.2f}   {asked}")
            good &= what != TUNED or not rms or float(np.median(rms)) <= ASKED
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
