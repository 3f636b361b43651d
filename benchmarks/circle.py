"""What an effect still costs once the circle is closed: calibrate, run, diagnose that run, run again with its model.

    ./peltier benchmark circle [--seeds N] [--first 10] [--only class,outside] [--effects delay,...]

Plate, films, target and noise are those of `benchmark tracking`; the effect is in the plant (`tests/truth.py`), written
apart from the program. For each film and effect: `calibrate`, `run`, `diagnose` that run, its model in
experiment.model, `run` again, as `improve` does: with what is named, or, where nothing is, with what was found and
predicts unseen rows better ("tried"); where nothing was, with the calibration's again. The error of the film itself is
told over the same rig's without the effect. `--effects wrong` is a plate that is a fifth off in all and a thermometer
that is 2 s late, calibrated as they are.

Asked: 1.2, no trip, and the effect alone named. On the film outside the class a delay costs what `benchmark
late_correction` says, whatever the law.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._bench import CONFIGURATION, NOMINAL, WRONG, WRONG_LAG, command, course, error, write_target
from benchmarks._harness import options, side_by_side
from tests.truth import FILMS, Effects, Plant

ASKED = 1.2
EFFECTS: dict[str, Effects] = {
    "film_lag": {"film_lag": {"tau_s": 2.0}},
    "sink": {"heat_sink_warmup": {"sink_capacity_ratio": 10.0, "sink_conductance_ratio_per_s": 0.167}},
    "self_heating": {"self_heating": {"theta_K_per_W": 3000.0}},
    "sensor_lag": {"sensor_lag": {"tau_s": 2.0}},
    "delay": {"actuator_delay": {"delay_s": 1.0}},
    "film_drift": {"film_drift": {"drift_K_per_h": 2.0}},
    "wrong": WRONG_LAG,
}


@dataclass
class Rig:
    """Commands on one film with one effect ("none": without), in a folder of its own; each begins with a film that has
    seen nothing."""

    kind: str
    seed: int
    effect: str
    folder: Path

    def command(self, verb: str, out: str, model: str) -> tuple[float, float]:
        """`calibrate`, or `run` with its RMS and largest error of the film (n). Raises RuntimeError with what was said
        where it ends early."""
        film = FILMS[self.kind](self.seed)
        times, values = course(film, self.seed)
        write_target(self.folder, times, values)
        path = self.folder / "config.toml"
        path.write_text(CONFIGURATION.format(model=model, law="full"))
        plate, hidden = WRONG if self.effect == "wrong" else NOMINAL, EFFECTS.get(self.effect)
        words = [verb, path, "--out", self.folder / out]
        ended = command(words, lambda start_s: Plant(plate, film, self.seed, start_s, hidden))
        if ended.status:
            raise RuntimeError(f"{verb} {out}: {ended.said}")
        return error(ended.plants[-1], ended.begin_s[0], times, values) if ended.begin_s else (0.0, 0.0)


def circled(case: tuple[str, int, str]) -> dict[str, Any]:
    """The errors of one case, and what was said where it did not come to its end."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="circle-") as folder:
        rig = Rig(*case, Path(folder))
        try:
            rig.command("calibrate", "cal", "target.csv")
            found["first"] = rig.command("run", "first", "cal/MODEL.toml")
            if rig.effect != "none":
                found["named"], found["tried"], model = diagnosed(rig)
                found["again"] = rig.command("run", "again", model)
        except RuntimeError as ended:
            found["text"] = str(ended)
    return found


def diagnosed(rig: Rig) -> tuple[list[str], list[str], str]:
    """The effects that `diagnose` names in the first run; those that it found where it names none; and the model with
    them, in the folder."""
    from rig.experiment.improvement import no_better
    from rig.records.film_output import FALLING_RESISTANCE
    from rig.records.record_file import read_record
    from rig.report.batch import CANDIDATE, MODEL

    first, report = rig.folder / "first", rig.folder / "first-diagnosis"
    ended = command(["diagnose", first / "record.csv", "--report", report])
    if ended.status:
        raise RuntimeError(f"diagnose: {ended.said}")
    document = json.loads((report / "diagnosis.json").read_text())
    named = [str(effect["name"]) for effect in document["effects"]]
    best = document["candidates"][:1] if not named and (report / CANDIDATE).is_file() else []
    tried = [str(name) for one in best for name in one["names"]]
    model = report / (CANDIDATE if tried else MODEL)
    record = read_record(first / "record.csv")
    # `improve` then leaves the model as it is
    if not (named or tried) or no_better(model, first / "model.toml", record, FALLING_RESISTANCE, named or tried):
        return named, tried, "cal/MODEL.toml"
    return named, tried, f"{report.name}/{model.name}"


def main() -> int:
    asked = options(__doc__, seeds=1, first=10, only=tuple(FILMS), effects=tuple(EFFECTS))
    seeds = range(asked.first, asked.first + asked.seeds)
    cases = [(kind, seed, effect) for kind in asked.only for seed in seeds for effect in ("none", *asked.effects)]
    without, ratios, right, ended = 1.0, [], 0, 0
    print("errors of the film in n = 0.002 decades, RMS (largest), and over the same without the effect")
    for (kind, seed, effect), found in zip(cases, side_by_side(circled, cases, asked.workers), strict=True):
        ended += "text" in found
        right += effect != "none" and found.get("named") == list(EFFECTS[effect])
        without = found["first"][0] if effect == "none" and "first" in found else without
        for run in ("first", "again"):
            if run in found:
                rms, most = found[run]
                print(
                    f"{kind:8s} {seed:3d} {effect:13s} {run:6s} {rms:5.2f} ({most:5.2f})  {rms / without:5.2f}",
                    flush=True,
                )
        ratios += [found["again"][0] / without] if "again" in found else []
        for said in ("named", "tried", "text"):
            if found.get(said):
                print(f"{kind:8s} {seed:3d} {effect:13s} {said}: {found[said]}", flush=True)
    within = sum(ratio <= ASKED for ratio in ratios)
    if ratios:
        print(f"median {np.median(ratios):.2f}  worst {max(ratios):.2f}  within {ASKED}: {within} of {len(ratios)}")
    print(f"named, and nothing else: {right} of {len(cases) - len(asked.only) * asked.seeds}; ended early: {ended}")
    return 1 if ended else 0


if __name__ == "__main__":
    sys.exit(main())
