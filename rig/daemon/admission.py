"""Whether a configuration may run on this bench: the same instruments, guarded no less, files where they may be.

A job may differ from the bench in what is listed here and in nothing else, so that a key that comes to the schema later
guards from its first day. Where a smaller number is the tighter guard, a job may be guarded tighter.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.bench.serial_numbers import strangers
from rig.config.configuration import ConfigurationFile, configuration_of, read_configuration
from rig.config.configuration_text import without_secrets
from rig.config.schema import Table
from rig.config.toml_file import parsed_toml, read_text, shown
from rig.core.faults import Faults, fault
from rig.drivers.identity import Identity
from rig.drivers.registry import is_own

LARGEST_FILE = 1_000_000  # bytes
# What to do and how to compute it. [simulation] is of a rig that is built already, [serve] is the daemon's own, [epics]
# of the server beside it: a job's has no effect.
FREE_TABLES = {"experiment", "control", "calibration", "simulation", "sweep", "serve", "epics"}
FREE = {
    "bench.time",  # a daemon's is always real
    "bench.controller.serial_number",  # where it is given, it has to be that of the instrument that answered
    "bench.meter.serial_number",
    "bench.meter.four_wire",  # how the film is read; the output is guarded by the thermometer
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


def configurations(folder: Path) -> list[dict[str, Any]]:
    """What may be started by name: {"name", "kind", "text"} of every TOML file with an [experiment] and a [bench]."""
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
    """The configuration of a name from `configurations`. Raises Faults. for_experiment: as of `read_configuration`."""
    known = [entry["name"] for entry in configurations(folder)]
    if not isinstance(name, str) or name not in known:
        raise fault("configuration", shown(name), f"expected one of {', '.join(known) or 'none: there is none'}")
    return read_configuration(folder / f"{name}.toml", for_experiment)


def by_text(text: object, name: object, folder: Path, for_experiment: bool = True) -> ConfigurationFile:
    """A configuration that came as text, with its files from the configurations' folder and from nowhere else."""
    if not isinstance(text, str):
        raise fault("text", type(text).__name__, "expected a configuration as text (TOML)")
    if name is not None and not isinstance(name, str):
        raise fault("name", type(name).__name__, "expected text")
    where = Path(name or "job")
    raw = parsed_toml(text, where)
    lines = [
        f"{where}: {place}: {shown(value)}: expected a file in the configurations' folder, without a path"
        for place, value in _files_of(raw)
        if isinstance(value, str) and Path(value).name != value
    ]
    target = dict(_files_of(raw))["experiment.target"]
    if isinstance(target, str) and target.lower().endswith(".toml"):  # whose first line a fault would quote
        lines.append(f"{where}: experiment.target: {shown(target)}: expected a file with columns, or words")
    lines += [f"{where}: {place}: names Python code; expected a job started by its name" for place in _code_of(raw)]
    if lines:
        raise Faults(lines)
    try:
        return configuration_of(folder / "job.toml", text, raw, for_experiment)
    except Faults as faults:
        raise Faults(line.replace(str(folder / "job.toml"), str(where)) for line in faults.lines) from None


def _code_of(raw: dict[str, Any]) -> list[str]:
    """Places that would run Python code with the daemon's rights: a driver or an effect of a user's own."""
    bench, simulation = raw.get("bench"), raw.get("simulation")
    found = []
    for role in ("controller", "meter"):
        table = bench.get(role) if isinstance(bench, dict) else None
        if isinstance(table, dict) and is_own(str(table.get("driver"))):
            found.append(f"bench.{role}.driver")
    if isinstance(simulation, dict) and simulation.get("effect_files"):
        found.append("simulation.effect_files")
    return found


def _files_of(raw: dict[str, Any]) -> list[tuple[str, Any]]:
    """(place, value) of every key that names a file."""
    places = [("experiment", "target"), ("experiment", "model"), ("simulation", "film", "model")]
    found = []
    for place in places:
        value: Any = raw
        for key in place:
            value = value.get(key) if isinstance(value, dict) else None
        found.append((".".join(place), value))
    return found


def admit(job: ConfigurationFile, bench: ConfigurationFile, identities: Mapping[str, Identity]) -> None:
    """Raises Faults where a job asks for other instruments than the bench has, or loosens what guards it. identities:
    who answered at the bench's ports, as far as it was ever there."""
    lines = strangers(job, identities)
    for table in type(bench.content).model_fields:
        if table not in FREE_TABLES:
            lines += _differences(job.path, table, getattr(job.content, table), getattr(bench.content, table))
    if lines:
        raise Faults(lines)


def _differences(path: Path, place: str, want: Any, have: Any) -> list[str]:
    """A line for each key below a place in which a job's value is none that it may have."""
    if want == have or place in FREE:
        return []
    if isinstance(want, Table) and isinstance(have, Table):
        keys = type(have).model_fields
        return [line for key in keys for line in _differences(path, f"{place}.{key}", *_both(key, want, have))]
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


def _both(key: str, want: Table, have: Table) -> tuple[Any, Any]:
    return getattr(want, key), getattr(have, key)


def same_port(one: str, other: str) -> bool:
    """Whether two names are the same device."""
    return one == other or ("://" not in one + other and os.path.realpath(one) == os.path.realpath(other))
