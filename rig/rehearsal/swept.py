"""Many cases of one configuration: experiments on the simulated rig, and what identification or diagnosis make of them
or of records. One row of a table each."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.config.configuration_text import digest_named_files
from rig.config.schema import validate
from rig.config.tables import SweepFile, SweepTable, SweepTask
from rig.config.toml_file import read_toml
from rig.core.errors import RigError
from rig.core.faults import Faults, fault
from rig.core.outcome import Outcome
from rig.many.cases import Case
from rig.many.computed import compute_missing
from rig.many.engine import Engine, EngineChoice, given
from rig.many.journal import Journal
from rig.records.record import Refused, content_digest
from rig.records.record_file import Record, read_record, write_columns
from rig.rehearsal.points import Point, check_points, configuration_at, points_of
from rig.rehearsal.simulated import simulate, target_error
from rig.version import __version__

Values = dict[str, Any]


@dataclass(frozen=True)
class Sweep:
    """What there is to do. identities: what each case is, by number; records: by number, where there are any, read or
    refused."""

    path: Path
    raw: dict[str, Any]
    table: SweepTable
    points: list[Point]
    records: list[Record | Refused]

    @property
    def identities(self) -> dict[int, Values]:
        """Of each case, with what it is a case of: another configuration or version makes other rows."""
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
    """The sweep of a configuration, checked. Raises Faults before anything is begun."""
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
    """Those that can be read, and those that are refused. Raises Faults where none is left."""
    paths, lines = [], []
    for name in names:
        found = sorted(path.parent.glob(name)) if not Path(name).is_absolute() else [Path(name)]
        lines += [] if found else [f"{path}: sweep.records: {name!r}; expected names of files beside this one"]
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
    """Of what decides a case's outcome and is not in its row; named: the files that it rests on."""
    rest = {**raw, "sweep": {"what": raw["sweep"].get("what", "experiment")}, "version": __version__}
    if named:
        rest["files"] = sorted(named.items())
    return hashlib.sha256(json.dumps(rest, sort_keys=True, default=str).encode()).hexdigest()[:12]


def sweep(
    todo: Sweep, out: Path, choice: EngineChoice, keep_records: bool, tell: Callable[[int, int, Values], None]
) -> list[Values]:
    """The table's rows, in the order of their numbers; tell(done, of, row) as each ends. Raises Faults."""
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

    compute_missing(journal, cases, choice, tell)
    return journal.rows()


def of_point(what: SweepTask, path: Path, raw: Any, point: Point, records: Path | None) -> Values:
    """In a worker: one simulated experiment, and what is made of it; what goes wrong is a row too."""
    try:
        simulated = simulate(configuration_at(path, given(raw), point), lambda text: None, None)
    except (Faults, Outcome, RigError) as error:
        return {"status": "failed", "text": in_a_line(error)}
    if records is not None:
        write_columns(records / f"record_{point.number:05d}.csv", simulated.columns)
    ended = simulated.ended
    row: Values = {"status": "done" if ended is None else "tripped", "rows": simulated.rows}
    row |= target_error(simulated)
    if ended is not None:
        row["text"] = in_a_line(ended)
    if what == "experiment":
        return row
    columns = {name: c for name, c in simulated.columns.items() if not isinstance(c, list)}
    return {**row, **_made_of(what, Record(columns, source=f"case {point.number}"))}


def of_record(what: SweepTask, record: Any) -> Values:
    """In a worker: what is made of one record."""
    return {"status": "done", **_made_of(what, given(record))}


def _made_of(what: SweepTask, record: Record) -> Values:
    from rig.analysis.one_row import of_diagnosis, of_identification

    try:
        if what == "diagnosis":
            from rig.analysis.diagnosed import diagnosed

            return of_diagnosis(diagnosed([record])[0].document())
        from rig.analysis.identified import AskedFit, identified
        from rig.report.identified_records import in_words

        found = identified([record], AskedFit(), lambda text: None)
        return of_identification(in_words(found, lambda text: None))
    except Faults as faults:
        return {"status": "failed", "text": in_a_line(faults)}


def in_a_line(error: Exception) -> str:
    """What went wrong, for a cell of a table."""
    return " / ".join(str(error).splitlines())


def row_in_words(row: Mapping[str, Any]) -> str:
    """A row as a line."""
    return " ".join(f"{key}={value}" for key, value in row.items() if value != "" and key != "of")
