"""Whether a configuration may run on this bench: the same instruments, limits no wider, files where they may be."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.drivers.identity import Identity
from rig.drivers.registry import is_own
from rig.faults import Faults, fault
from rig.files.configuration import ConfigurationFile, ControllerTable, MeterTable, configuration_of, read_configuration
from rig.serial_numbers import strangers

LARGEST_FILE = 1_000_000  # bytes


def configurations(folder: Path) -> list[dict[str, Any]]:
    """What may be started by name: {"name", "kind", "text"} of every TOML file with an [experiment] and a [bench]."""
    found = []
    for path in sorted(folder.glob("*.toml")):
        try:
            if path.stat().st_size > LARGEST_FILE:
                continue
            text = path.read_text(encoding="utf-8")
            content = tomllib.loads(text)
        except (OSError, ValueError):
            continue
        if isinstance(content.get("bench"), dict) and isinstance(content.get("experiment"), dict):
            kind = content["experiment"].get("kind", "track_resistance")
            found.append({"name": path.stem, "kind": str(kind), "text": text})
    return found


def by_name(name: object, folder: Path) -> ConfigurationFile:
    """The configuration of a name from `configurations`. Raises Faults."""
    known = [entry["name"] for entry in configurations(folder)]
    if not isinstance(name, str) or name not in known:
        raise fault("configuration", repr(name)[:80], f"expected one of {', '.join(known) or 'none: there is none'}")
    return read_configuration(folder / f"{name}.toml")


def by_text(text: object, name: object, folder: Path) -> ConfigurationFile:
    """A configuration that came as text, with its files from the configurations' folder and from nowhere else."""
    if not isinstance(text, str):
        raise fault("text", type(text).__name__, "expected a configuration as text (TOML)")
    if name is not None and not isinstance(name, str):
        raise fault("name", type(name).__name__, "expected text")
    where = Path(name or "job")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise fault(where, "", f"is no TOML: {error}") from None
    except RecursionError:
        raise fault(where, "", "is no TOML: nested too deeply") from None
    lines = [
        f"{where}: {place}: {value!r}: expected a file in the configurations' folder, without a path"
        for place, value in _files_of(raw)
        if isinstance(value, str) and Path(value).name != value
    ]
    lines += [f"{where}: {place}: names Python code; expected a job started by its name" for place in _code_of(raw)]
    if lines:
        raise Faults(lines)
    try:
        return configuration_of(folder / "job.toml", text, raw)
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
    """Raises Faults where a job asks for other instruments than the bench has, or for wider limits. identities: who
    answered at the bench's ports, as far as it was ever there."""
    lines = strangers(job, identities)
    ours, theirs = bench.content, job.content
    pairs: list[tuple[str, ControllerTable | MeterTable | None, ControllerTable | MeterTable | None]] = [
        ("controller", ours.bench.controller, theirs.bench.controller),
        ("meter", ours.bench.meter, theirs.bench.meter),
    ]
    for role, have, want in pairs:
        if want is None:
            continue
        if have is None:
            lines.append(f"{job.path}: bench.{role}: the bench has none; expected no [bench.{role}]")
            continue
        for key in ("driver", "options", "baud"):
            if getattr(want, key) != getattr(have, key):
                expected = f"{getattr(want, key)!r}: expected the bench's, {getattr(have, key)!r}"
                lines.append(f"{job.path}: bench.{role}.{key}: {expected}")
        if not same_port(want.port, have.port):
            lines.append(f"{job.path}: bench.{role}.port: {want.port!r}: expected the bench's, {have.port!r}")
    limit, wanted = ours.limits, theirs.limits
    if not (limit.temperature_degC[0] <= wanted.temperature_degC[0] <= wanted.temperature_degC[1]) or (
        wanted.temperature_degC[1] > limit.temperature_degC[1]
    ):
        expected = f"expected within the bench's, {list(limit.temperature_degC)}"
        lines.append(f"{job.path}: limits.temperature_degC: {list(wanted.temperature_degC)}: {expected}")
    for key in ("current_A", "meter_current_A"):
        if getattr(wanted, key) > getattr(limit, key):
            expected = f"expected at most the bench's, {getattr(limit, key):g}"
            lines.append(f"{job.path}: limits.{key}: {getattr(wanted, key):g}: {expected}")
    if lines:
        raise Faults(lines)


def same_port(one: str, other: str) -> bool:
    """Whether two names are the same device."""
    return one == other or ("://" not in one + other and os.path.realpath(one) == os.path.realpath(other))
