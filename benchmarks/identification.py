"""How well and how fast films and plates are identified: a table of figures beside what is asked.

    python -m benchmarks.identification [--quick]

Measured records are found through PELTIER_DATA (default ../shared/data); rows that need one are left out without it.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import rig
from compensator.hysteresis.film import FilmModel
from compensator.thermal.plate import PlateModel
from sim.inference.film.fit import FilmFit, FilmRecord, identify_film, identify_film_records
from sim.inference.plate.fit import identify_plate
from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii, random_profile, relay_film

Array = NDArray[np.float64]
DATA = Path(os.environ.get("PELTIER_DATA", Path(__file__).parents[2] / "shared" / "data"))
NOISE = 0.002


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def outputs(film: FilmModel, v: Array) -> Array:
    return film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0]


def row(what: str, figure: str, asked: str) -> None:
    print(f"{what:<68} {figure:<34} {asked}", flush=True)


def timed(call: Callable[[], FilmFit]) -> tuple[FilmFit, float]:
    began = time.perf_counter()
    fit = call()
    return fit, time.perf_counter() - began


def measured_film() -> None:
    file = DATA / "vo2_film_major_loop.tsv"
    if not file.is_file():
        return
    table = np.loadtxt(file, skiprows=1)
    t, v, y = table[:, 0], table[:, 1] - 273.15, -np.log10(table[:, 2])
    for kind in ("generalized_pi", "extended_generalized_pi", None):
        fit, took = timed(lambda kind=kind: identify_film(t, v, y, kind=kind))  # type: ignore[misc]
        name = f"measured film, {kind or 'default: ' + fit.model.kind}, D {fit.model.memoryless.function}"
        asked = {"generalized_pi": "0.153 elsewhere", "extended_generalized_pi": "0.057 elsewhere", None: "<= 0.06"}[
            kind
        ]
        row(name, f"{fit.rmse:.4f} dec, {fit.model.operators} operators, {took:.2f} s", asked)
    for kind in ("extended_generalized_pi", None):
        fit = identify_film(t, v, np.where(np.arange(y.size) % 2 == 0, y, np.nan), kind=kind)
        error = rms((outputs(fit.model, v) - y)[1::2])
        row(f"measured film, even rows fitted, odd rows predicted, {kind or 'default'}", f"{error:.4f} dec", "<= 0.035")


def films_of_the_class(count: int) -> None:
    for noise_K in (0.0, 0.01):
        ratios, inside, took = [], [], []
        for seed in range(count):
            rng = np.random.default_rng(1000 + seed)
            film, v = is_prandtl_ishlinskii(seed), decaying_profile(5000)
            y = outputs(film, v) + NOISE * rng.normal(size=v.size)
            t = 0.5 * np.arange(v.size)
            noisy = v + noise_K * rng.normal(size=v.size)
            fit, seconds = timed(lambda t=t, noisy=noisy, y=y: identify_film(t, noisy, y))  # type: ignore[misc]
            elsewhere = random_profile(4000, seed)
            prediction = fit.predict(0.5 * np.arange(4000), elsewhere, temperature_noise_K=0.0)
            off = prediction.output - outputs(film, elsewhere)
            ratios.append(np.hypot(1.0, rms(off) / NOISE))
            inside.append(float(np.mean(np.abs(off) < prediction.half_width)))
            took.append(seconds)
        name = f"{count} films of the class, thermometer noise {noise_K} K: RMSE / noise elsewhere"
        row(name, f"median {np.median(ratios):.4f}, worst {max(ratios):.4f}", "<= 1.02")
        row("    95 % band holds the true curve at", f"{100 * np.mean(inside):.0f} % of rows", "95 %")
        row("    time, 5,000 rows", f"{np.mean(took):.2f} s", "<= 3 s")


def relay_films() -> None:
    v, elsewhere = decaying_profile(4000), random_profile(4000, 5)
    y = relay_film(v) + NOISE * np.random.default_rng(0).normal(size=v.size)
    truth = relay_film(elsewhere)
    for kind in ("generalized_pi", "extended_generalized_pi", None):
        fit, took = timed(lambda kind=kind: identify_film(0.5 * np.arange(v.size), v, y, kind=kind))  # type: ignore[misc]
        error = rms(outputs(fit.model, elsewhere) - truth)
        asked = {"generalized_pi": "0.0285 elsewhere", "extended_generalized_pi": "0.008 elsewhere", None: "0.006"}[
            kind
        ]
        what = f"relay film, random profile, {kind or 'default: ' + fit.model.kind}"
        row(what, f"{error:.4f} dec, {fit.model.operators} operators, {took:.2f} s", asked)


def long_record() -> None:
    v = decaying_profile(10_000)
    y = outputs(is_prandtl_ishlinskii(0), v) + NOISE * np.random.default_rng(0).normal(size=v.size)
    noisy = v + 0.01 * np.random.default_rng(1).normal(size=v.size)
    fit, took = timed(lambda: identify_film(0.5 * np.arange(v.size), noisy, y))
    row("10,000 samples, 30 operators", f"{took:.2f} s, RMSE / noise {fit.rmse / NOISE:.3f}", "<= 5 s")
    halves = [
        FilmRecord(np.arange(5000.0), noisy[:5000], y[:5000]),
        FilmRecord(np.arange(5000.0), noisy[5000:], y[5000:]),
    ]
    fit, took = timed(lambda: identify_film_records(halves))
    row("the same as two records", f"{took:.2f} s, RMSE / noise {fit.rmse / NOISE:.3f}", "-")


def plates(count: int) -> None:
    plate = PlateModel(1.6e-3, 0.06, 0.018, 24.0)
    truth = np.array([1.6e-3, 0.06, 0.018, 24.0, 0.0, 0.0])  # the last two: slopes with temperature
    t = np.arange(0.0, 1500.0, 0.5)
    current = np.interp(t, [0, 300, 301, 700, 701, 1100, 1101, 1500], [2, 2, -1, -1, 3, 3, -2, -2]) + 0.5 * np.sin(
        t / 30
    )
    clean = plate.simulate(24.0, t, current)
    worst, inside, took = 0.0, [], []
    for seed in range(count):
        noisy = clean + 0.01 * np.random.default_rng(seed).normal(size=t.size)
        began = time.perf_counter()
        fit = identify_plate(t, noisy, current)
        took.append(time.perf_counter() - began)
        worst = max(worst, float(np.max(np.abs(fit.values[:4] / truth[:4] - 1.0))))
        inside.append(np.abs(fit.values - truth) < 1.96 * fit.standard_errors)
    row(f"{count} plates, noise 0.01 K: worst parameter", f"{100 * worst:.3f} %", "1 %")
    row("    95 % intervals hold the truth", f"{100 * np.mean(inside):.0f} %", "95 %")
    row("    time, 3,000 rows", f"{1e3 * np.mean(took):.0f} ms", "milliseconds")
    for file in sorted(DATA.glob("peltier_*.csv")):
        measured = identify_plate(*np.genfromtxt(file, delimiter=",", skip_header=1).T)
        figure = f"{measured.rmse_K:.2f} K, {len(measured.identifiability)} notes"
        row(f"measured plate {file.stem}: RMSE of the simulation", figure, "-")


def film_and_plate(rows: int, jitter: float) -> rig.Record:
    """A record with a current, at half a second a row; jitter: of the row's times, of the distance of rows."""
    random = np.random.default_rng(0)
    t = 0.5 * np.arange(rows)
    t = np.sort(t + jitter * 0.5 * random.uniform(-1.0, 1.0, rows))
    turns = np.cumsum(np.append(0.0, random.uniform(60.0, 90.0, rows // 150)))
    levels = np.where(np.arange(turns.size) % 2, -0.2, 2.6) + 0.4 * random.normal(size=turns.size)
    current = np.interp(t, turns, levels)
    v = PlateModel(1.6e-3, 0.06, 0.018, 24.0).simulate(24.0, t, current)
    film = is_prandtl_ishlinskii(1)
    y = film.simulate(v, film.initial_memory(24.0, "heated"))[0] + NOISE * random.normal(size=rows)
    columns = {"temperature_degC": v + 0.01 * random.normal(size=rows), "resistance_ohm": 10.0**-y}
    return rig.read_record({"time_s": t, "current_A": current, **columns})


def film_with_plate() -> None:
    rig.identify(film_and_plate(1500, 0.0))  # compiles
    first = 0.0
    for rows, jitter in ((6000, 0.0), (14000, 0.3), (50000, 0.0)):
        record = film_and_plate(rows, jitter)
        began = time.process_time()
        found = rig.identify(record)
        took = time.process_time() - began
        first = first or took
        assert found.film is not None
        figure = f"{took:.2f} s, {took / first:.1f} times; RMSE / noise {found.film.rmse / NOISE:.3f}"
        row(f"film and plate, {rows} rows, jitter {jitter}: computing", figure, "3 s; 3 and 10 times")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="fewer films and plates")
    few = parser.parse_args().quick
    identify_film(
        np.arange(400.0), decaying_profile(400), outputs(is_prandtl_ishlinskii(0), decaying_profile(400))
    )  # compiles
    row("what", "figure", "asked")
    measured_film()
    films_of_the_class(4 if few else 20)
    relay_films()
    long_record()
    film_with_plate()
    plates(10 if few else 100)


if __name__ == "__main__":
    main()
