"""What a diagnosis document is worth beside the truth of its case; rates with Wilson intervals; confusion matrix."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from math import isfinite, sqrt
from typing import Any

from tests.sim.diagnosis.cases import Case

Document = dict[str, Any]
Row = dict[str, Any]
OF_THE_FILM = {"film_lag", "self_heating", "film_drift", "creep", "memoryless_term"}
# No interval has a meaning for these: a step is read off the lattice, a threshold off the ranges, D has a form.
WITHOUT_INTERVAL = {
    ("thermometer_quantization", "step_K"),
    ("meter_range_error", "threshold_ohm"),
    ("memoryless_term", "form"),
    ("memoryless_term", "amplitude"),
}
WIDEST = 2.0  # an interval wider than this times the true value says nothing
CONFIDENT = 0.05  # a finding that clean records reach more often is not made with confidence


def intervals(case: Case, document: Document) -> list[tuple[str, str, bool, float]]:
    """(effect, parameter, whether the truth is inside, width over truth) of each hidden parameter of a named effect; an
    interval that is missing or wider than `WIDEST` times the truth is a miss."""
    out = []
    for finding in document["effects"]:
        for parameter, true in case.hidden.get(finding["name"], {}).items():
            if (finding["name"], parameter) in WITHOUT_INTERVAL:
                continue
            ci = finding["parameters"].get(parameter, {}).get("ci95")
            width = (ci[1] - ci[0]) / abs(true) if ci and all(isfinite(end) for end in ci) else float("inf")
            inside = bool(ci) and width <= WIDEST and ci[0] <= true <= ci[1]
            out.append((finding["name"], parameter, inside, width))
    return out


def remains(document: Document) -> float | None:
    """The worst channel's error after the extension over its noise, on rows that no fit has seen."""
    ratios = [
        channel["rmse_extended"] / channel["noise"]
        for channel in document["channels"].values()
        if channel and channel.get("rmse_extended") is not None and channel.get("noise")
    ]
    return max(ratios) if ratios else None


def confidently_named(document: Document) -> list[str]:
    """Effects that the document names alone and with few false alarms."""
    return [
        finding["name"]
        for finding in document["effects"]
        if not finding["indistinguishable_from"] and (finding.get("false_alarm") or 0.0) < CONFIDENT
    ]


def score(case: Case, document: Document, after: Document | None = None) -> Row:
    """The row of one case. `ok` is what the case's kind asks; `after` is the document of its follow-up."""
    names = [finding["name"] for finding in document["effects"]]
    hidden = set(case.hidden)
    left = any(document["unexplained"].values())
    row: Row = {
        "kind": case.kind,
        "seed": case.seed,
        "film": case.film,
        "hidden": sorted(hidden),
        "named": names,
        "verdict": document["verdict"],
        "first": bool(names) and names[0] in hidden,
        "found": hidden <= set(names),
        "exactly": hidden == set(names) and len(names) == len(hidden),
        "clean": not names and document["verdict"] == "clean",
        "innocents": [name for name in names if name not in hidden],
        "instruments_blamed": [name for name in names if name not in hidden and name not in OF_THE_FILM],
        "hedged": any(finding["indistinguishable_from"] for finding in document["effects"]),
        "unexplained": left,
        "intervals": intervals(case, document),
        "remains": remains(document),
    }
    if case.expectation == "set":
        row["set_named"] = named_as_set(case, document)
        row["decided"] = after is not None and [f["name"] for f in after["effects"]] == sorted(hidden)
    row["ok"] = passed(case, row, document)
    return row


def named_as_set(case: Case, document: Document) -> bool:
    """One finding, one of the doubles, with all the doubles beside it."""
    if len(document["effects"]) != 1:
        return False
    finding = document["effects"][0]
    together = {finding["name"], *finding["indistinguishable_from"]}
    return finding["name"] in case.acceptable and set(case.acceptable) <= together


def passed(case: Case, row: Row, document: Document) -> bool:
    """What is asked of a case of this expectation."""
    if case.kind == "smallest":
        return bool(row["first"])
    if case.kind == "other_film":
        return not row["instruments_blamed"]
    if case.kind == "other_film_effect":
        return bool(row["found"])
    if case.kind == "further_film":
        return bool(row["found"]) and not row["instruments_blamed"]
    if case.kind == "real_noise":  # a lattice of readings is the instrument's last digit
        return set(row["named"]) - {"thermometer_quantization"} == set(case.hidden)
    if case.expectation == "clean":
        return bool(row["clean"])
    if case.expectation == "unexplained":
        return bool(row["unexplained"]) and not row["named"]
    if case.expectation == "set":
        return bool(row["set_named"])
    if case.expectation == "no_name":
        return not confidently_named(document)
    return bool(row["exactly"])


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """The 95 % interval of a rate."""
    if count == 0:
        return 0.0, 1.0
    rate = hits / count
    middle = (rate + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * sqrt(rate * (1 - rate) / count + z * z / (4 * count * count))
    return max(0.0, middle - half), min(1.0, middle + half)


def confusion(rows: Iterable[Row]) -> dict[str, dict[str, int]]:
    """Hidden effect (or outside fault, or nothing) to how often each name came first; of cases with at most one."""
    out: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for row in rows:
        if len(row["hidden"]) > 1:
            continue
        truth = row["hidden"][0] if row["hidden"] else row.get("details", {}).get("fault", "nothing")
        said = row["named"][0] if row["named"] else ("unexplained" if row["unexplained"] else "clean")
        out[truth][said] += 1
    return {truth: dict(said) for truth, said in out.items()}


def coverage(rows: Iterable[Row]) -> dict[str, tuple[int, int]]:
    """effect.parameter to (inside, counted)."""
    out: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for row in rows:
        for effect, parameter, inside, _ in row["intervals"]:
            out[f"{effect}.{parameter}"][0] += bool(inside)
            out[f"{effect}.{parameter}"][1] += 1
    return {key: (hits, count) for key, (hits, count) in out.items()}
