"""Many cases of one configuration, a row of a table each: simulated experiments, identifications, diagnoses, runs.

A sweep varies keys of a configuration, every value with every other or points spread evenly over ranges, and identifies
or diagnoses each record. The runs of a folder are diagnosed once each, known by the digest of their record.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.analysis.error import target_error
from rig.batch import Case, Engine, EngineChoice, Journal, compute_missing, given
from rig.config.configuration import ConfigurationFile
from rig.config.effect_tables import add_effect_files, parse_effect, switch_effects
from rig.config.schema import validate
from rig.config.tables import SweepFile, SweepTable, SweepTask
from rig.config.toml_file import digest_named_files, read_toml
from rig.core.errors import RigError
from rig.core.faults import Faults, fault
from rig.core.outcome import Outcome
from rig.experiment.simulation import simulate, simulated_configuration, table_in
from rig.records.record import Refused, content_digest
from rig.records.record_file import Record, read_record, write_columns
from rig.records.run_folder import FinishedRun
from rig.version import __version__

Values = dict[str, Any]
DIGITS = 12  # of a digest in hexadecimal: 48 bits, which a double holds exactly


@dataclass(frozen=True)
class Point:
    """One simulated experiment: its number, the keys that are set, effects in words, the noise's seed."""

    number: int
    parameters: dict[str, Any]
    effects: tuple[str, ...]
    seed: int

    def identity(self) -> dict[str, Any]:
        """Return the columns that identify it: numbers and text."""
        shown = {key: value if type(value) in (int, float) else str(value) for key, value in self.parameters.items()}
        return {"number": self.number, **shown, "effects": " ".join(self.effects), "seed": self.seed}


def points_of(table: SweepTable) -> Iterator[Point]:
    """Yield the points of a plan."""
    effects = [tuple(names) for names in table.effects]
    seeds = list(range(table.seeds)) if isinstance(table.seeds, int) else table.seeds
    if table.plan == "grid":
        values = itertools.product(*table.parameters.values())
        for number, (chosen, names, seed) in enumerate(itertools.product(values, effects, seeds)):
            yield Point(number, dict(zip(table.parameters, chosen, strict=True)), names, seed)
        return
    from scipy.stats import qmc

    assert table.samples is not None
    unit = qmc.LatinHypercube(len(table.ranges), seed=table.plan_seed).random(table.samples)
    lows, highs = zip(*table.ranges.values(), strict=True)
    for number, chosen in enumerate(qmc.scale(unit, lows, highs).tolist()):
        names = effects[number % len(effects)] if effects else ()
        seed = seeds[number % len(seeds)] if isinstance(table.seeds, list) and seeds else number
        yield Point(number, dict(zip(table.ranges, chosen, strict=True)), names, seed)


def configuration_at(path: Path, raw: dict[str, Any], point: Point) -> ConfigurationFile:
    """Return a configuration (raw: as TOML gave it) with the point's values, effects and seed, on simulated ports.
    Raises Faults."""
    varied, effects, seed = _varied(path, raw, point)
    return simulated_configuration(path, varied, effects, seed)


def _varied(path: Path, raw: dict[str, Any], point: Point) -> tuple[dict[str, Any], list[dict[str, Any]], int]:
    """Return the raw configuration with the point's values; its effects; its seed."""
    raw = copy.deepcopy(raw)
    files = table_in(raw, "simulation").get("effect_files", [])
    add_effect_files(path.parent / name for name in (files if isinstance(files, list) else []) if isinstance(name, str))
    for key, value in point.parameters.items():
        *tables, last = key.split(".")
        inner = raw
        for name in tables:
            inner = table_in(inner, name)
        inner[last] = value
    return raw, [parse_effect(text) for text in point.effects], point.seed


def check_points(path: Path, raw: dict[str, Any], points: list[Point]) -> None:
    """Check every value and every effect once, before hours are spent; of a Latin hypercube, the first and the last
    point. Raises Faults."""
    if not points:
        raise fault(path, "sweep", "nothing to do: expected at least one value of each")
    hypercube = "ranges" in raw["sweep"]
    seen: set[str] = set()
    for point in (points[0], points[-1]) if hypercube else points:
        texts = [f"{key}={value}" for key, value in point.parameters.items()]
        fresh = [text for text in (*texts, str(point.effects)) if text not in seen]
        if not fresh and seen:
            continue
        seen.update(fresh)
        varied, tables, seed = _varied(path, raw, point)
        lines = switch_effects(tables, f"{path}: sweep.effects", complete=False)[1]
        if lines:
            raise Faults(lines)
        simulated_configuration(path, varied, tables, seed)


@dataclass(frozen=True)
class Sweep:
    """A sweep that was checked. points: the experiments, or records: read or refused, by number."""

    path: Path
    raw: dict[str, Any]
    table: SweepTable
    points: list[Point]
    records: list[Record | Refused]

    @property
    def identities(self) -> dict[int, Values]:
        """Identity of each case, by number. Another configuration or version makes other cases."""
        folder = self.path.parent
        if self.records:
            of = _digest(self.raw, {})
            return {
                n: {"number": n, "record": record.source, "of": of, "holds": content_digest(record)}
                for n, record in enumerate(self.records)
            }
        rest = {name: table for name, table in self.raw.items() if name != "sweep"}
        named = digest_named_files(rest, folder)
        return {
            point.number: {
                **point.identity(),
                "of": _digest(self.raw, {**named, **digest_named_files(point.parameters, folder)}),
            }
            for point in self.points
        }


def read_sweep(path: Path) -> Sweep:
    """Read the sweep of a configuration, and check it. Raises Faults before anything is begun."""
    raw = read_toml(path)
    if "sweep" not in raw:
        raise fault(path, "sweep", "missing; expected a table [sweep] with seeds, effects, parameters")
    table = validate(SweepFile, {"sweep": raw["sweep"]}, path).sweep
    if table.records:
        return Sweep(path, raw, table, [], _records(path, table.records))
    points = list(points_of(table))
    check_points(path, raw, points)
    return Sweep(path, raw, table, points, [])


def _records(path: Path, names: list[str]) -> list[Record | Refused]:
    """Read the records, or why they are refused. Raises Faults if none is left."""
    paths, lines = [], []
    for name in names:
        found = sorted(path.parent.glob(name)) if not Path(name).is_absolute() else [Path(name)]
        lines += (
            [] if found else [f"{path}: sweep.records: {name!r}; expected names of files in the folder of this one"]
        )
        paths += found
    if lines:
        raise Faults(lines)
    records: list[Record | Refused] = []
    for one in dict.fromkeys(paths):
        try:
            records.append(read_record(one))
        except Faults as faults:
            records.append(Refused(str(one), tuple(faults.lines)))
    if all(isinstance(record, Refused) for record in records):
        raise Faults(line for record in records if isinstance(record, Refused) for line in record.faults)
    return records


def _digest(raw: dict[str, Any], named: Mapping[str, str]) -> str:
    """Return a digest of what decides a case's result and is not in its row; named: digests of files."""
    rest = {**raw, "sweep": {"what": raw["sweep"].get("what", "experiment")}, "version": __version__}
    if named:
        rest["files"] = sorted(named.items())
    return hashlib.sha256(json.dumps(rest, sort_keys=True, default=str).encode()).hexdigest()[:12]


def sweep(
    todo: Sweep, out: Path, choice: EngineChoice, keep_records: bool, on_done: Callable[[int, int, Values], None]
) -> list[Values]:
    """Compute a sweep; return the table's rows, in the order of their numbers. on_done(done, of, row) is called as each
    case ends. Raises Faults."""
    journal = Journal(out, "sweep", todo.identities, same=("of", "holds", "record") if todo.records else ())
    for number, record in enumerate(todo.records):
        if isinstance(record, Refused):
            journal.note(number, {"status": "failed", "text": " / ".join(record.faults)})
    folder = out if keep_records else None

    def cases(engine: Engine, left: list[int]) -> Iterator[Case]:
        raw = engine.share(todo.raw)
        for number in left:
            if todo.records:
                yield Case(number, of_record, (todo.table.what, engine.share(todo.records[number])))
            else:
                yield Case(number, of_point, (todo.table.what, todo.path, raw, todo.points[number], folder))

    compute_missing(journal, cases, choice, on_done)
    return journal.rows()


def of_point(what: SweepTask, path: Path, raw: Any, point: Point, records: Path | None) -> Values:
    """Simulate one experiment, in a worker, and identify or diagnose it; a failure is a row too."""
    try:
        simulated = simulate(configuration_at(path, given(raw), point), lambda text: None, None)
    except (Faults, Outcome, RigError) as error:
        return {"status": "failed", "text": in_a_line(error)}
    if records is not None:
        write_columns(records / f"record_{point.number:05d}.csv", simulated.columns)
    ended = simulated.ended
    row: Values = {"status": "done" if ended is None else "tripped", "rows": simulated.rows}
    found = target_error(simulated)
    row |= found.document() if found is not None else {}
    if ended is not None:
        row["text"] = in_a_line(ended)
    if what == "experiment":
        return row
    columns = {name: c for name, c in simulated.columns.items() if not isinstance(c, list)}
    return {**row, **_made_of(what, Record(columns, source=f"case {point.number}"))}


def of_record(what: SweepTask, record: Any) -> Values:
    """Identify or diagnose one record, in a worker."""
    return {"status": "done", **_made_of(what, given(record))}


def _made_of(what: SweepTask, record: Record) -> Values:
    from rig.analysis.trend import of_diagnosis, of_identification

    try:
        if what == "diagnosis":
            from rig.analysis.diagnosed import diagnosed

            return of_diagnosis(diagnosed([record])[0].document())
        from rig.analysis.identification import FitOptions, identified

        return of_identification(identified([record], FitOptions(), lambda text: None).document())
    except Faults as faults:
        return {"status": "failed", "text": in_a_line(faults)}


def in_a_line(error: Exception) -> str:
    """Return an error as a cell of a table."""
    return " / ".join(str(error).splitlines())


def row_in_words(row: Mapping[str, Any]) -> str:
    """Return a row as a line."""
    return " ".join(f"{key}={value}" for key, value in row.items() if value != "" and key != "of")


def diagnose_runs(
    runs: Sequence[FinishedRun],
    folder: Path,
    out: Path,
    choice: EngineChoice,
    on_done: Callable[[int, int, Values], None],
) -> list[Values]:
    """Diagnose runs that were not diagnosed before; return a row for each, in the order of their times: run, at, rig,
    and the diagnosis. Raises Faults."""
    numbered: dict[int, FinishedRun] = {}
    for run in runs:
        number = int(hashlib.sha256(run.record.read_bytes() + run.at.isoformat().encode()).hexdigest()[:DIGITS], 16)
        numbered.setdefault(number, run)
    identities = {number: _identity(number, run, folder) for number, run in numbered.items()}
    journal = Journal(out, "trend", identities, same=("number", "run", "at", "rig"))

    def cases(engine: Engine, left: list[int]) -> Iterator[Case]:
        for number in left:
            try:
                record = read_record(numbered[number].record)
            except Faults as faults:
                journal.add(number, {"status": "failed", "text": in_a_line(faults)}, 0.0)
                continue
            yield Case(number, of_record, ("diagnosis", engine.share(record)))

    compute_missing(journal, cases, choice, on_done)
    return sorted(journal.rows(), key=lambda row: str(row["at"]))


def _identity(number: int, run: FinishedRun, folder: Path) -> Values:
    name = run.folder.relative_to(folder).as_posix() if run.folder != folder else run.folder.name
    return {"number": number, "run": name, "at": run.at.isoformat(timespec="seconds"), "rig": run.rig}
