"""What a file has to be asked for: lines with the --column to type, for whatever is needed and not plain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compensator.hysteresis.functions import Array
from rig.files.column_mapping import ending_of, typed
from rig.files.column_meaning import meaning_of
from rig.files.field_times import time_like
from rig.files.taking import Taking
from rig.files.units import CONDUCTANCES

ASKED_UNITS = {
    "s": ("s", "ms", "min", "h", "d"),
    "degC": ("degC", "K", "degF"),
    "ohm": ("ohm", "kohm", "Mohm", "S"),
    "A": ("A", "mA"),
}
DRIVE_UNITS = ("duty", "percent", "pwm255")
OTHER_UNIT = {
    "time_s": "time_min",
    "target_ohm": "target_kohm",
    "setpoint_degC": "setpoint_K",
    "current_A": "current_mA",
}


def ask(taking: Taking, needs: Sequence[str]) -> None:
    """Lines for what is needed and not plain, and for what looks like a resistance or a current and is not plain."""
    if not taking.table.named and not taking.chosen:
        taking.faults.append(taking.at_names(_without_names(taking)))
        return
    for ours in needs:
        if ours not in taking.chosen and ours not in taking.renamed.values():
            text = f"column {ours!r} missing; there are {taking.there()}{_to_type(taking, ours)}"
            taking.faults.append(taking.at_names(text))
    for ours in ("temperature_degC", "resistance_ohm", "current_A"):
        if ours in taking.chosen or ours in needs or not taking.flags:
            continue
        for k in [k for k in taking.free() if taking.meanings[k].ours == ours and taking.filled(k)]:
            what = taking.to_type(ours, k, _units_asked(taking, ours, k))
            why, another = _why(taking, ours, k)
            if ours == "resistance_ohm" and not another:
                keep = typed(taking.names[k] or f"column{k + 1}", taking.names, k)
                text = f"{taking.shown[k]!r}: {why}; expected {what} or, to leave it as it is, {keep}"
                taking.faults.append(taking.at_names(text))
            else:
                taking.said.append(f"{taking.shown[k]!r} left: {why}; if it is {ours}, {what}")


def _why(taking: Taking, ours: str, k: int) -> tuple[str, bool]:
    """Why a column was not taken, and whether its name says that it may be of something else."""
    meaning = taking.meanings[k]
    if meaning.doubt:
        return meaning.doubt, False
    if ours == "current_A" and (
        meaning.unit == "percent" or (meaning.unit is None and not _is_current(taking.names[k]))
    ):
        return "a share of full drive?", False
    if meaning.plain:
        several = sum(each.ours == ours and each.plain for each in taking.meanings) > 1
        return ("more than one column may be it" if several else "too small for a plate's current"), False
    if meaning.unit is not None:
        return "a word of its name is not known", True
    return "its unit is not said", False


def _units_asked(taking: Taking, ours: str, k: int) -> Sequence[str]:
    """The units to offer: that of the name where it has one, else the usual ones."""
    meaning = taking.meanings[k]
    if meaning.doubt.startswith("the name says"):
        return (str(meaning.unit), "ohm" if meaning.unit in CONDUCTANCES else "S")
    if meaning.unit is not None and not (ours == "current_A" and meaning.unit == "percent"):
        return (meaning.unit,)
    if ending_like(taking.names[k]) and ours == "temperature_degC":
        return ({"C": "degC", "degC": "degC", "K": "K", "F": "degF"}[taking.names[k].strip().rpartition("_")[2]],)
    if "milliohms" in meaning.doubt:
        return ("Mohm", "mohm")
    if "logarithm's" in meaning.doubt:
        return ("log10ohm", "lnohm")
    if ours == "current_A" and meaning.unit == "percent":
        values = taking.values(k)
        return DRIVE_UNITS[:2] if values is not None and np.max(np.abs(values)) <= 1.0 else ("percent",)
    if ours == "current_A" and not _is_current(taking.names[k]):
        return DRIVE_UNITS
    if ours == "temperature_degC":
        values = taking.values(k)
        if values is not None and np.min(values) > 200.0:
            return ("K", "degC")
    return ASKED_UNITS[ending_of(ours)]


def _is_current(name: str) -> bool:
    return meaning_of(f"{name} (mA)").plain and not meaning_of(f"{name} (%)").plain


def _to_type(taking: Taking, ours: str) -> str:
    """What to type for a column that is missing: for each that may be it, in each unit."""
    free = [k for k in taking.free() if taking.filled(k)]
    likely = [k for k in free if taking.meanings[k].ours == ours]
    if not likely and ours == "time_s":
        likely = [k for k in free if time_like(taking.first(k)) or _rises(taking.values(k))]
    if not likely and ours == "temperature_degC":
        likely = [k for k in free if ending_like(taking.names[k]) == "degC" and taking.values(k) is not None]
    if not likely:
        return ""
    if not taking.flags:
        return f"; expected the name {ours}, or it with another unit, as {OTHER_UNIT.get(ours, ours)}"
    most = 2 if len(likely) > 1 else 5  # units to offer for each
    lines = [taking.to_type(ours, k, _units_asked(taking, ours, k)[:most]) for k in likely[:4]]
    why = next((taking.meanings[k].doubt for k in likely if taking.meanings[k].doubt), "")
    return f"; {why + '; ' if why else ''}expected {' or '.join(lines)}"


def ending_like(name: str) -> str:
    """'degC' for a name that ends like a temperature's, as 'y_C' or 'plate1_K'."""
    tail = name.strip().rpartition("_")[2]
    return "degC" if tail in ("C", "K", "degC", "F") else ""


def _rises(values: Array | None) -> bool:
    return values is not None and values.size >= 2 and bool(np.all(np.diff(values) > 0.0))


def _without_names(taking: Taking) -> str:
    """What to type for a file without names, by what its columns look like; a proposal that has to be looked at."""
    told: dict[str, str] = {}
    for k in range(len(taking.names)):
        values = taking.values(k)
        if time_like(taking.first(k)):
            told.setdefault("time_s", f"#{k + 1}")
        elif values is None:
            continue
        elif "time_s" not in told and _rises(values):
            told["time_s"] = f"#{k + 1}@s"
        elif "temperature_degC" not in told and np.min(values) > -60.0 and np.max(values) < 500.0:
            unit = "K" if np.min(values) > 200.0 else "degC"
            told["temperature_degC"] = f"#{k + 1}@{unit}"
        elif "resistance_ohm" not in told and np.min(values) > 0.0:
            told["resistance_ohm"] = f"#{k + 1}@ohm"
    lines = " ".join(f"--column '{ours}={theirs}'" for ours, theirs in told.items()) or "--column 'time_s=#1@s'"
    return (
        f"no names above {len(taking.names)} columns of numbers; expected --column OURS=#NUMBER@UNIT for each, "
        f"as it might be {lines}"
    )
