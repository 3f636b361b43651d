"""How well measured films, and films outside the class, are identified, and how fast: figures beside what is asked.

    ./peltier benchmark identification

Measured records are found through PELTIER_DATA (default ../shared/data); rows that need one are left out without it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import rig
from compensator.hysteresis.film import FilmModel
from compensator.thermal.plate import PlateModel
from sim.inference.film.fit import FilmFit, identify_film
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
    identify_film(
        np.arange(400.0), decaying_profile(400), outputs(is_prandtl_ishlinskii(0), decaying_profile(400))
    )  # compiles
    row("what", "figure", "asked")
    measured_film()
    relay_films()
    film_with_plate()


if __name__ == "__main__":
    main()
