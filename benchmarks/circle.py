"""What a known effect still costs: hidden, its model with the effect, and the error over the one without the effect.

    ./peltier benchmark circle [--seeds N] [--only class|outside] [--effects film_lag,...] [--diagnosed]

Plate, films, target and noise are those of `benchmark tracking`; the effect is in the plant (`_hidden_effects`),
written apart from the program. For each film and effect the rig is calibrated, the target is run with each law, and the
error of the film itself is reported as a ratio to the same rig's without the effect:

    unknown     with the model of a calibration that knows of no effect
    true        with the same model and the effect as it is; the film and plate are those of a rig without it
    diagnosed   with --diagnosed (or --only-diagnosed): calibrate, run, `diagnose` that run, its model in
                experiment.model, run again, as `improve` does: with what is named, or, where nothing is, with what was
                found and predicts unseen rows better ("tried"); where nothing was, with the calibration's again

`--effects wrong --only-diagnosed` is a plate that is a fifth off in all and a thermometer that is 2 s late, calibrated
as they are: with the model of another rig `run` refuses to go on, rightly (docs/decisions.md, 19).

Asked: 1.2, no trip, and the effect alone named. The ohmmeter's test current is limited to 0.1 mA. On the film outside
the class a delay costs what `benchmark late_correction` says, whatever the law.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._hidden_effects import EffectPlant, Hidden
from benchmarks._own_plant import behind_the_instruments, noted_phase
from benchmarks._tracked_plant import Plate
from benchmarks._tracking_runs import COLD_DEGC, CONFIGURATION, FILMS, HOT_DEGC, WRONG, course, error, span

ASKED = 1.2
EFFECTS: dict[str, tuple[Hidden, str]] = {
    "film_lag": (Hidden(film_lag_s=2.0), 'name = "film_lag"\ntau_s = 2.0'),
    "sink": (
        Hidden(sink_capacity_ratio=10.0, sink_conductance_ratio_per_s=0.167),
        'name = "heat_sink_warmup"\nsink_capacity_ratio = 10.0\nsink_conductance_ratio_per_s = 0.167',
    ),
    "self_heating": (Hidden(theta_K_per_W=3000.0), 'name = "self_heating"\ntheta_K_per_W = 3000.0'),
    "sensor_lag": (Hidden(sensor_lag_s=2.0), 'name = "sensor_lag"\ntau_s = 2.0'),
    "delay": (Hidden(delay_s=1.0), 'name = "actuator_delay"\ndelay_s = 1.0'),
    "film_drift": (Hidden(film_drift_K_per_h=2.0), 'name = "film_drift"\ndrift_K_per_h = 2.0'),
}
WRONG_RIG = "wrong"  # the thermometer's lag, on the wrong plate of `benchmark tracking`


@dataclass(frozen=True)
class Case:
    """One film with one effect ("none": without)."""

    film: str
    seed: int
    effect: str
    laws: tuple[str, ...]
    ways: tuple[str, ...]


@dataclass
class Rig:
    """Commands on one film with one effect, in a folder of its own; each begins with a film that has seen nothing."""

    case: Case
    folder: Path
    times: list[float]
    values: list[float]

    def command(self, verb: str, out: str, model: str, law: str) -> tuple[float, float] | None:
        """`calibrate` or `run`; RMS and largest error of the film (n) over the track. Raises RuntimeError with what it
        said where it ends early."""
        from rig.__main__ import main

        text = CONFIGURATION.format(current=4.0, model=model, law=law, low=COLD_DEGC, high=HOT_DEGC)
        path = self.folder / "config.toml"
        path.write_text(text.replace("[experiment]", "meter_current_A = 1e-4\n[experiment]"))
        err = io.StringIO()
        with self._plants() as plants:
            note = noted_phase(lambda name: name == "track")
            with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()), note as begin_s:
                status = main([verb, str(path), "--out", str(self.folder / out)])
            if status:
                raise RuntimeError(f"{verb} {out}: {err.getvalue()[-300:]}")
            return error(plants[-1], begin_s[0], self.times, self.values) if begin_s else None

    @contextlib.contextmanager
    def _plants(self) -> Iterator[list[Any]]:
        case, plate = self.case, WRONG if self.case.effect == WRONG_RIG else Plate()
        hidden = hidden_of(case.effect)[0] if case.effect != "none" else Hidden()
        film = FILMS[case.film]
        with behind_the_instruments(
            lambda start_s: EffectPlant(plate, film(case.seed), case.seed, start_s, hidden)
        ) as plants:
            yield plants


def hidden_of(effect: str) -> tuple[Hidden, str]:
    """What is in the plant, and in the model of who knows it."""
    return EFFECTS["sensor_lag" if effect == WRONG_RIG else effect]


def circled(case: Case) -> dict[str, Any]:
    """The errors of one case by way and law, and what was said where it did not come to its end."""
    folder = Path(tempfile.mkdtemp(prefix="circle-"))
    times, values = course(*span(FILMS[case.film](case.seed)), case.seed)
    lines = [f"{t:.3f},{10.0**y:.8g}" for t, y in zip(times, values, strict=True)]
    (folder / "target.csv").write_text("time_s,target_ohm\n" + "\n".join(lines) + "\n")
    rig = Rig(case, folder, times, values)
    found: dict[str, Any] = {"film": case.film, "seed": case.seed, "effect": case.effect}
    try:
        plain = Rig(Case(case.film, case.seed, "none", (), ()), folder, times, values)
        if case.effect == "none" or "true" in case.ways:
            plain.command("calibrate", "plain", "target.csv", "full")
        ways = {} if case.effect != "none" else {"none": "plain/MODEL.toml"}
        if "true" in case.ways:
            known = (folder / "plain" / "MODEL.toml").read_text() + "\n[[effects]]\n" + hidden_of(case.effect)[1] + "\n"
            (folder / "known.toml").write_text(known)
            ways["true"] = "known.toml"
        if "diagnosed" in case.ways:
            rig.command("calibrate", "cal", "target.csv", "full")
            found["unknown"] = {"full": rig.command("run", "first", "cal/MODEL.toml", "full")}
            found["named"], found["tried"], ways["diagnosed"] = diagnosed(folder)
        for way, model in ways.items():
            found[way] = {law: rig.command("run", f"{way}-{law}", model, law) for law in case.laws}
    except RuntimeError as ended:
        found["text"] = str(ended)
    shutil.rmtree(folder, ignore_errors=True)
    return found


def diagnosed(folder: Path) -> tuple[list[str], list[str], str]:
    """The effects that `diagnose` names in the first run; those that it found where it names none; and the model with
    them, in the folder."""
    from rig.__main__ import main
    from rig.experiment.improvement import no_better
    from rig.records.film_output import FALLING_RESISTANCE
    from rig.records.record_file import read_record
    from rig.report.batch import CANDIDATE, MODEL

    report, err = folder / "first-diagnosis", io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        status = main(["diagnose", str(folder / "first" / "record.csv"), "--report", str(report)])
    if status:
        raise RuntimeError(f"diagnose: {err.getvalue()[-300:]}")
    document = json.loads((report / "diagnosis.json").read_text())
    named = [str(effect["name"]) for effect in document["effects"]]
    best = document["candidates"][:1] if not named and (report / CANDIDATE).is_file() else []
    tried = [str(name) for one in best for name in one["names"]]
    model, first = report / (CANDIDATE if tried else MODEL), folder / "first"
    record = read_record(first / "record.csv")
    # `improve` then leaves the model as it is
    if not (named or tried) or no_better(model, first / "model.toml", record, FALLING_RESISTANCE, named or tried):
        return named, tried, "cal/MODEL.toml"
    return named, tried, f"{report.name}/{model.name}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=10)
    parser.add_argument("--only", choices=sorted(FILMS))
    parser.add_argument("--effects", default=",".join(EFFECTS))
    parser.add_argument("--laws", default="full,feedforward")
    parser.add_argument("--diagnosed", action="store_true")
    parser.add_argument("--only-diagnosed", action="store_true", help="leave out the way `true`")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    laws = tuple(options.laws.split(","))
    ways = ("diagnosed",) if options.only_diagnosed else ("true", "diagnosed") if options.diagnosed else ("true",)
    kinds = [options.only] if options.only else list(FILMS)
    effects = ["none", *options.effects.split(",")]
    seeds = range(options.first, options.first + options.seeds)
    cases = [
        Case(kind, seed, effect, laws, ways if effect != "none" else ())
        for kind in kinds
        for seed in seeds
        for effect in effects
    ]
    without: dict[tuple[str, int, str], float] = {}
    ratios: dict[str, list[float]] = {}
    ended = right = 0
    print("errors of the film in n = 0.002 decades, RMS (largest), and over the same without the effect")
    with ProcessPoolExecutor(options.workers) as pool:
        for r in pool.map(circled, cases):
            ended += "text" in r
            right += "named" in r and hidden_of(r["effect"])[1].startswith(f'name = "{"+".join(r["named"])}"')
            for way in ("none", "unknown", "true", "diagnosed"):
                for law, (rms, most) in r.get(way, {}).items():
                    key = (r["film"], r["seed"], law)
                    without.setdefault(key, rms)
                    ratio = rms / without[key]
                    print(f"{r['film']:8s} {r['seed']:3d} {r['effect']:13s} {way:10s} {law:12s} ", end="")
                    print(f"{rms:5.2f} ({most:5.2f})  {ratio:5.2f}", flush=True)
                    ratios.setdefault(f"{way} {law}", []).append(ratio)
            for said in ("named", "tried", "text"):
                if said in r:
                    print(f"{r['film']:8s} {r['seed']:3d} {r['effect']:13s} {said}: {r[said]}", flush=True)
    for name, found in ratios.items():
        within = sum(ratio <= ASKED for ratio in found)
        print(f"{name:24s} median {np.median(found):.2f}  worst {max(found):.2f}", end="")
        print(f"  within {ASKED}: {within} of {len(found)}")
    circled_cases = sum("diagnosed" in case.ways for case in cases)
    if circled_cases:
        print(f"named, and nothing else: {right} of {circled_cases}; ended early: {ended}")
    return 1 if ended else 0


if __name__ == "__main__":
    sys.exit(main())
