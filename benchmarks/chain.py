"""One chain: a model simulated, fitted, predicted and observed; and a diagnosis' model in the hands of `predict`.

    ./peltier benchmark chain [--triples 300] [--cases 50] [--first 72000] [--records] [--results FILE]

Triples: random sets of three effects in random order, by the simulated rig, the fits' forward model, `predict` and the
observer, noise-free on the same nodes (`tests.sim.four_ways`): the largest difference in kelvin and decades.
Cases: blind records with one to three effects. `diagnose --holdout --out` on the one, `predict --initial fitted` on the
other: the error over the one that the diagnosis said, by channel; and with --records the same for pairs of measured
records in PELTIER_DATA (by default ../shared/data). Each finished case is a line of the results file; started again,
the benchmark goes on where it was.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

ASKED_AGREEMENT = 1e-6
ASKED_RATIO = 0.05
KINDS = ("one", "one", "two", "three")
DUTY = ("--column", "time_s=time@s", "--column", "current_A=output@duty", "--column", "temperature_degC=temp@degC")
PAIRS = (  # fitted, held out, how to read both
    ("peltier_80510.csv", "peltier_8052.csv", DUTY),
    ("peltier_80510.csv", "peltier_8051.csv", DUTY),
)


def triples(count: int) -> None:
    """The largest differences over random triples."""
    from tests.sim.four_ways import differences, every_effect, on

    rng, worst = random.Random(0), {}
    for k in range(count):
        chosen = rng.sample(every_effect(), 3)
        for way, (off_K, off_dec) in differences(tuple(on(e) for e in chosen)).items():
            known = worst.get(way, (0.0, 0.0))
            worst[way] = max(known[0], off_K), max(known[1], off_dec)
        print(f"\r{k + 1} of {count} triples", end="", file=sys.stderr)
    for way, (off_K, off_dec) in worst.items():
        found = f"{count} triples: {off_K:.1e} K, {off_dec:.1e} dec"
        print(f"{way:<10} against the simulated rig, {found}   asked {ASKED_AGREEMENT:g}")


def of_case(number: int, first: int) -> dict[str, Any]:
    """One blind case: what was said and what was got, by channel."""
    from tests.sim.diagnosis.cases import case, write_record

    kind = KINDS[number % len(KINDS)]
    truth = case(kind, first + number)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_record(truth, folder / "record.csv")
        assert truth.holdout is not None
        write_record(truth, folder / "other.csv", truth.holdout)
        found = said_and_got(folder / "record.csv", folder / "other.csv", folder)
    return {"key": f"{kind} {first + number}", "hidden": sorted(truth.hidden), **found}


def said_and_got(record: Path, other: Path, folder: Path, words: tuple[str, ...] = ()) -> dict[str, Any]:
    """`diagnose --holdout --out`, then `predict --initial fitted` on the held-out record."""
    model = folder / "model.toml"
    said = _json(folder, "diagnose", str(record), "--holdout", str(other), "--out", str(model), *words)
    got = _json(folder, "predict", str(model), str(other), "--initial", "fitted", *words)
    channels = {}
    for channel, unit in (("temperature_K", "K"), ("resistance_dec", "dec")):
        if said["channels"][channel] is not None and f"rmse_{unit}" in got:
            channels[channel] = [said["channels"][channel]["rmse_extended"], got[f"rmse_{unit}"]]
    return {"named": [e["name"] for e in said["effects"]], "verdict": said["verdict"], "said_got": channels}


def _json(folder: Path, *words: str) -> dict[str, Any]:
    from rig.__main__ import main

    path = folder / "out.json"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as told:
        status = main([*words, "--json", str(path)])
    if status != 0:
        raise RuntimeError(f"peltier {' '.join(words)}: exit {status}: {told.getvalue()[-500:]}")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def cases(count: int, first: int, results: Path) -> list[dict[str, Any]]:
    """All of them, the finished ones from the file."""
    done = {}
    if results.is_file():
        done = {row["key"]: row for row in map(json.loads, results.read_text(encoding="utf-8").splitlines())}
    rows = []
    for number in range(count):
        key = f"{KINDS[number % len(KINDS)]} {first + number}"
        if key not in done:
            done[key] = of_case(number, first)
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(done[key]) + "\n")
        rows.append(done[key])
        tell(done[key])
    return rows


def tell(row: dict[str, Any]) -> None:
    """A line of one case."""
    ratios = ", ".join(f"{c}: said {s:.4g}, got {g:.4g} ({g / s:.3f})" for c, (s, g) in row["said_got"].items())
    print(f"{row['key']:<14} {'+'.join(row['named']) or row['verdict']:<50} {ratios}", flush=True)


def table(rows: list[dict[str, Any]]) -> None:
    """Of the ratios."""
    for channel in ("temperature_K", "resistance_dec"):
        ratios = [g / s for row in rows for c, (s, g) in row["said_got"].items() if c == channel]
        if ratios:
            close = sum(abs(r - 1.0) <= ASKED_RATIO for r in ratios)
            print(
                f"{channel}: got over said: within 5 % {close} of {len(ratios)}; "
                f"median {statistics.median(ratios):.3f}, largest {max(ratios):.3f}, least {min(ratios):.3f}"
            )


def measured() -> list[dict[str, Any]]:
    """Pairs of measured records."""
    folder, rows = Path(os.environ.get("PELTIER_DATA", ROOT.parent / "shared" / "data")), []
    for one, other, words in PAIRS:
        if not (folder / one).is_file() or not (folder / other).is_file():
            print(f"{one}, {other}: not in {folder}")
            continue
        with tempfile.TemporaryDirectory() as temporary:
            row = {"key": f"{one[8:-4]} {other[8:-4]}"}
            row |= said_and_got(folder / one, folder / other, Path(temporary), words)
        rows.append(row)
        tell(row)
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triples", type=int, default=300)
    parser.add_argument("--cases", type=int, default=50)
    parser.add_argument("--first", type=int, default=72000, help="the first seed")
    parser.add_argument("--records", action="store_true", help="measured records, too")
    parser.add_argument("--results", type=Path, default=Path("chain_results.jsonl"))
    options = parser.parse_args()
    if options.triples:
        triples(options.triples)
    if options.records:
        measured()
    if options.cases:
        table(cases(options.cases, options.first, options.results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
