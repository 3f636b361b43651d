"""The configurations that a bench runs: by name, as text, or a hold; and the check that none loosens what guards it.

A job may differ from the bench in the keys listed here and in no other, so that a key that comes to the schema later
guards from its first day. Where a smaller number is the tighter guard, a job may be guarded tighter.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from rig.config.configuration import ConfigurationFile, configuration_of, read_configuration
from rig.config.model_file import read_model
from rig.config.schema import Table
from rig.config.toml_file import parsed_toml, read_text, shown, without_secrets
from rig.core.clock import DAY_S
from rig.core.faults import Faults, fault
from rig.core.reading import Identity
from rig.drivers.registry import is_own

LARGEST_FILE = 1_000_000  # bytes
# The experiment and its computation. A job's [simulation] has no effect, as the rig is built already, nor has [serve],
# the daemon's own, or [epics], the EPICS server's.
FREE_TABLES = {"experiment", "control", "calibration", "simulation", "sweep", "serve", "epics"}
FREE = {
    "bench.time",  # a daemon's is always real
    "bench.controller.serial_number",  # if given, it has to be that of the instrument that answered
    "bench.meter.serial_number",
    "bench.meter.four_wire",  # reading of the film; the thermometer guards the output
    "bench.meter.nplc",
    "bench.meter.average",
}
PORTS = {"bench.controller.port", "bench.meter.port"}
AT_MOST = {  # the smaller, the sooner it trips or the less may flow
    "bench.controller.dead_man_s",
    "limits.current_A",
    "limits.meter_current_A",
    "limits.stale_s",
    "limits.rate_K_per_s",
    "limits.runaway_s",
}
WITHIN = {"limits.temperature_degC"}
FILES = (("experiment", "target"), ("experiment", "model"), ("simulation", "film", "model"))  # keys that name a file
USUAL_S = 600.0  # of a hold without a time: long enough to look at a film, too short to be forgotten
SHORTEST_S, LONGEST_S = 1.0, 7 * DAY_S  # longer holds need a configuration


def history_folder(file: ConfigurationFile) -> Path:
    """Return the folder of runs and history: serve.folder beside the configuration, else runs/ where it was started."""
    folder = file.content.serve.folder
    return file.beside(folder) if folder is not None else Path("runs").absolute()


def model_of(file: ConfigurationFile) -> Path | None:
    """Return the path of the film's model that a configuration names."""
    name = file.content.experiment.model
    return file.beside(name).absolute() if name is not None else None


def configurations(folder: Path) -> list[dict[str, Any]]:
    """Return {"name", "kind", "text"} of every TOML file with an [experiment] and a [bench]."""
    found = []
    for path in sorted(folder.glob("*.toml")):
        try:
            text = read_text(path, LARGEST_FILE)
            content = parsed_toml(text, path)
        except Faults:
            continue
        if isinstance(content.get("bench"), dict) and isinstance(content.get("experiment"), dict):
            kind = content["experiment"].get("kind", "track_resistance")
            found.append({"name": path.stem, "kind": str(kind), "text": without_secrets(text)})
    return found


def by_name(name: object, folder: Path, for_experiment: bool = True) -> ConfigurationFile:
    """Read a configuration by its name. Raises Faults. for_experiment: see `read_configuration`."""
    known = [entry["name"] for entry in configurations(folder)]
    if not isinstance(name, str) or name not in known:
        raise fault("configuration", shown(name), f"expected one of {', '.join(known) or 'none: there is none'}")
    return read_configuration(folder / f"{name}.toml", for_experiment)


def by_text(text: object, name: object, folder: Path, for_experiment: bool = True) -> ConfigurationFile:
    """Parse a configuration that came as text; its files may only be in the configurations' folder. Raises Faults."""
    if not isinstance(text, str):
        raise fault("text", type(text).__name__, "expected a configuration as text (TOML)")
    if name is not None and not isinstance(name, str):
        raise fault("name", type(name).__name__, "expected text")
    where = Path(name or "job")
    raw = parsed_toml(text, where)
    files = {".".join(place): _value_at(raw, place) for place in FILES}
    lines = [
        f"{where}: {place}: {shown(value)}: expected a file in the configurations' folder, without a path"
        for place, value in files.items()
        if isinstance(value, str) and Path(value).name != value
    ]
    target = files["experiment.target"]
    if isinstance(target, str) and target.lower().endswith(".toml"):  # a fault would quote its first line
        lines.append(f"{where}: experiment.target: {shown(target)}: expected a file with columns, or words")
    lines += [f"{where}: {place}: names Python code; expected a job started by its name" for place in _code_in(raw)]
    if lines:
        raise Faults(lines)
    try:
        return configuration_of(folder / "job.toml", text, raw, for_experiment)
    except Faults as faults:
        raise Faults(line.replace(str(folder / "job.toml"), str(where)) for line in faults.lines) from None


def _code_in(raw: dict[str, Any]) -> list[str]:
    """Return the keys that would run Python code with the daemon's rights: a user's own driver or effect."""
    found = [
        f"bench.{role}.driver"
        for role in ("controller", "meter")
        if isinstance(table := _value_at(raw, ("bench", role)), dict) and is_own(str(table.get("driver")))
    ]
    return found + (["simulation.effect_files"] if _value_at(raw, ("simulation", "effect_files")) else [])


def _value_at(raw: dict[str, Any], place: tuple[str, ...]) -> Any:
    value: Any = raw
    for key in place:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def hold_of(bench: ConfigurationFile, degC: object, seconds: object, model: Path | None) -> ConfigurationFile:
    """Return the bench's own configuration with another [experiment], a hold at a temperature. Raises Faults.

    Everything that guards the bench stays. With a model of the plate the film's law holds the temperature, without one
    the controller's own regulation.
    """
    low, high = bench.content.limits.temperature_degC
    target_degC = float(degC) if _is_number(degC) else None  # type: ignore[arg-type]
    lasts_s = float(seconds) if _is_number(seconds) else None  # type: ignore[arg-type]
    lines = []
    if target_degC is None or not low < target_degC < high:
        lines.append(f"hold_degC: {shown(degC)}: expected a number between the bench's limits, {low:g} and {high:g}")
    if lasts_s is None or not SHORTEST_S <= lasts_s <= LONGEST_S:
        lines.append(f"hold_s: {shown(seconds)}: expected a number from {SHORTEST_S:g} to {LONGEST_S:g}")
    if lines:
        raise Faults(lines)
    experiment: dict[str, Any] = {
        "kind": "hold",
        "name": "hold",
        "target": [f"start {target_degC!r} degC", f"hold {lasts_s!r} s"],
        "period_s": bench.content.experiment.period_s,
        **({"model": str(model)} if _has_plate(model) else {"law": "instrument_pid"}),
    }
    raw = {**parsed_toml(bench.text, bench.path), "experiment": experiment}
    return configuration_of(bench.path, tomli_w.dumps(raw), raw)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _has_plate(model: Path | None) -> bool:
    if model is None or not model.is_file():
        return False
    try:
        return read_model(model).plate is not None
    except Faults:
        return False


def admit(job: ConfigurationFile, bench: ConfigurationFile, identities: Mapping[str, Identity]) -> None:
    """Raise Faults if a job asks for other instruments than the bench has, or loosens what guards it.

    identities: of the instruments at the bench's ports, as far as they ever answered.
    """
    lines = job.strangers(identities)
    for table in type(bench.content).model_fields:
        if table not in FREE_TABLES:
            lines += _differences(job.path, table, getattr(job.content, table), getattr(bench.content, table))
    if lines:
        raise Faults(lines)


def _differences(path: Path, place: str, want: Any, have: Any) -> list[str]:
    """Return a line for each key below a place in which a job's value is not allowed."""
    if want == have or place in FREE:
        return []
    if isinstance(want, Table) and isinstance(have, Table):
        keys = type(have).model_fields
        pairs = ((key, getattr(want, key), getattr(have, key)) for key in keys)
        return [line for key, wanted, given in pairs for line in _differences(path, f"{place}.{key}", wanted, given)]
    if place == "bench.meter":
        return [] if want is None else [f"{path}: {place}: the bench has none; expected no [bench.meter]"]
    if place in PORTS and same_port(want, have):
        return []
    if place in AT_MOST:
        return [f"{path}: {place}: {want:g}: expected at most the bench's, {have:g}"] if want > have else []
    if place in WITHIN:
        inside = have[0] <= want[0] and want[1] <= have[1]
        return [] if inside else [f"{path}: {place}: {list(want)}: expected within the bench's, {list(have)}"]
    return [f"{path}: {place}: {shown(want)}: expected the bench's, {shown(have)}"]


def same_port(one: str, other: str) -> bool:
    """Return True if two names are the same device."""
    return one == other or ("://" not in one + other and os.path.realpath(one) == os.path.realpath(other))
