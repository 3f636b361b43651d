"""Are the intervals of the transition's numbers right? 200 simulated films of three kinds, each told and judged.

    ./peltier benchmark transition [--records 200] [--first 0]

A record is a major loop, at times with a second one or with minor loops, of 0.03 to 0.6 K a row; the ohmmeter's noise
is 0.3 to 8 mdec and remembers none, half or 0.8 of the row before; the thermometer's is 2 to 50 mK, and its last digit
0.1 mK to 0.25 K (`_transition_films`). True is what the film's curve without noise shows. The derivative of a film of
play operators jumps at every operator, so that where it is largest is a matter of the window, which each number names:
there the derivative over this window is judged, and beside it the curve's own. Films of the other kinds are judged by
their own derivative. Asked: 92 to 98 % of the transition temperatures and hysteresis widths inside their intervals.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._transition_films import (
    KINDS,
    Known,
    draw_known,
    full_width_K,
    halfway_degC,
    steepest_degC,
    steepest_over_window_degC,
)

ASKED = ("heating_degC", "cooling_degC", "hysteresis_K")
LEAST, MOST = 0.92, 0.98
Judged = tuple[str, str, bool, bool, float, float]  # kind, name, inside, whether the curve's own is, half width, error


def judged(seed: int) -> tuple[list[Judged], list[tuple[str, str]]]:
    """The numbers of one record, judged, and those that it could not tell, with the reasons."""
    from sim.inference.film.fit import identify_film
    from sim.inference.transition.transition import transition

    known = draw_known(seed)
    record = known.time_s, known.temperature_degC, -known.log_ohm
    found = transition(identify_film(*record), *record)
    windows = {sense: shape.window_K for sense, shape in found.shapes.items()}
    own = truth(known, found.range_degC, {})
    true = truth(known, found.range_degC, windows) if known.kind == "of_class" else own
    rows, missing = [], []
    for name, quantity in found.quantities.items():
        if quantity.value is None or quantity.ci95 is None:
            missing.append((name, quantity.reason))
        elif name in true:
            low, high = quantity.ci95
            inside = low <= true[name] <= high, low <= own[name] <= high
            rows.append((known.kind, name, *inside, 0.5 * (high - low), abs(quantity.value - true[name])))
    return rows, missing


def truth(known: Known, ends_degC: tuple[float, float], windows: dict[str, float]) -> dict[str, float]:
    """What is true of a film, by name: its own derivative, or that over a window where one is given."""
    found: dict[str, float] = {}
    changes = []
    for sense, (degC, log_ohm) in (("heating", known.heating), ("cooling", known.cooling)):
        window = windows.get(sense)
        own = steepest_degC(degC, log_ohm)
        found[f"{sense}_degC"] = own if window is None else steepest_over_window_degC(degC, log_ohm, window)
        found[f"midpoint_{sense}_degC"] = halfway_degC(degC, log_ohm, ends_degC)
        if known.kind != "of_class":  # half of a jagged peak is anywhere
            found[f"width_{sense}_K"] = full_width_K(degC, log_ohm)
        changes.append(-float(np.diff(np.interp(ends_degC, degC, log_ohm))[0]))
    for name, what in (("hysteresis_K", "{}_degC"), ("hysteresis_at_midpoint_K", "midpoint_{}_degC")):
        found[name] = found[what.format("heating")] - found[what.format("cooling")]
    found["change_dec"] = float(np.mean(changes))
    if known.activation_eV is not None:
        found["activation_energy_eV"] = known.activation_eV
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with ProcessPoolExecutor() as pool:
        results = list(pool.map(judged, range(options.first, options.first + options.records), chunksize=5))
    rows = [row for found, _ in results for row in found]
    good = _told(rows)
    for name, reason in sorted({row for _, missing in results for row in missing}):
        print(f"not determined: {name}: {reason}")
    return 0 if good else 1


def _told(rows: list[Judged]) -> bool:
    """Print the table; whether what was asked for is there."""
    print(f"{'':<26}{'records':>9}{'inside 95 %':>13}" + "".join(f"{kind:>10}" for kind in KINDS), end="")
    print(f"{'own curve':>11}{'half width':>12}{'error':>10}{'asked':>12}")
    good = True
    for name in dict.fromkeys(row[1] for row in rows):
        mine = [row for row in rows if row[1] == name]
        share = float(np.mean([row[2] for row in mine]))
        by_kind = [[row[2] for row in mine if row[0] == kind] for kind in KINDS]
        shown = "".join(f"{100 * np.mean(hits):>8.1f} %" if hits else f"{'':>10}" for hits in by_kind)
        own = 100 * float(np.mean([row[3] for row in mine]))
        half, off = (float(np.median([row[k] for row in mine])) for k in (4, 5))
        asked = f"{100 * LEAST:g} to {100 * MOST:g} %" if name in ASKED else ""
        print(f"{name:<26}{len(mine):>9}{100 * share:>11.1f} %{shown}{own:>9.1f} %{half:>12.3g}{off:>10.2g}{asked:>12}")
        good = good and (name not in ASKED or LEAST <= share <= MOST)
    return good


if __name__ == "__main__":
    sys.exit(main())
