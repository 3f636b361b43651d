"""Are the intervals of the transition's numbers right? The films of `benchmark films`, each identified and judged.

    ./peltier benchmark transition [--records 400] [--first 0] [--workers 2]

Each record holds both major branches (others are left out), at times with minor loops; rows, rates, sampling, the noise
of thermometer and ohmmeter and their last digits are drawn (`_film_truths`). A film of relays or plays is steepest at
places that hang on the window through which one looks: an interval has to reach the range of these. Midpoints are
judged over the range that the program states. Asked: 92 to 98 % of each number inside its interval.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks._film_truths import Case, case_of
from benchmarks._harness import options, side_by_side

KINDS = ("play", "preisach")
LEAST, MOST = 0.92, 0.98
Judged = tuple[str, str, bool, float, float]  # kind, name, inside, half width, distance from the truth's range


def judged(seed: int) -> tuple[list[Judged], list[tuple[str, str]]]:
    """Return the numbers of one record, judged, and those that it could not tell, with the reasons."""
    from sim.inference.film.fit import identify_film
    from sim.inference.transition.transition import transition

    case = case_of(seed, KINDS[seed % len(KINDS)])
    if not all(case.branches):
        return [], []
    record = case.columns["time_s"], case.columns["temperature_degC"], -np.log10(case.columns["resistance_ohm"])
    found = transition(identify_film(*record), *record)
    rows, missing, true = [], [], case.transition | midpoints(case, found.range_degC)
    for name, (low, high) in ((name, truth) for name, truth in true.items() if truth is not None):
        quantity = found.quantities[name]
        if quantity.value is None or quantity.ci95 is None:
            missing.append((name, quantity.reason))
            continue
        inside = bool(quantity.ci95[0] <= high and low <= quantity.ci95[1])
        off = max(low - quantity.value, quantity.value - high, 0.0)
        rows.append((case.kind, name, inside, 0.5 * (quantity.ci95[1] - quantity.ci95[0]), off))
    return rows, missing


def midpoints(case: Case, ends_degC: tuple[float, float]) -> dict[str, tuple[float, float] | None]:
    """Return where each major branch is halfway between what it is at both ends, and the difference."""
    grid, found = np.linspace(*ends_degC, 6001), []
    for heating in (True, False):
        branch = case.film.branch(grid, heating)
        half = 0.5 * (branch[0] + branch[-1])
        k = int(np.argmax(branch > half))  # a background may fall beyond the transition
        found.append(float(np.interp(half, branch[k - 1 : k + 1], grid[k - 1 : k + 1])))
    names = "midpoint_heating_degC", "midpoint_cooling_degC", "hysteresis_at_midpoint_K"
    return {name: (at, at) for name, at in zip(names, (*found, found[0] - found[1]), strict=True)}


def main() -> int:
    asked = options(__doc__, records=400, first=0)
    results = list(side_by_side(judged, range(asked.first, asked.first + asked.records), asked.workers))
    rows, good = [row for found, _ in results for row in found], True
    print(f"{'':<26}{'records':>9}{'inside 95 %':>13}" + "".join(f"{kind:>11}" for kind in KINDS), end="")
    print(f"{'half width':>12}{'error':>10}   asked {100 * LEAST:g} to {100 * MOST:g} %")
    for name in dict.fromkeys(row[1] for row in rows):
        mine = [row for row in rows if row[1] == name]
        share = float(np.mean([row[2] for row in mine]))
        by_kind = [[row[2] for row in mine if row[0] == kind] for kind in KINDS]
        shown = "".join(f"{100 * np.mean(hits):>9.1f} %" if hits else f"{'':>11}" for hits in by_kind)
        half, off = (float(np.median([row[k] for row in mine])) for k in (3, 4))
        print(f"{name:<26}{len(mine):>9}{100 * share:>11.1f} %{shown}{half:>12.3g}{off:>10.2g}")
        good &= LEAST <= share <= MOST
    for name, reason in sorted({row for _, missing in results for row in missing}):
        print(f"not determined: {name}: {reason}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
