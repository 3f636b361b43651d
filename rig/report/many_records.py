"""Many records diagnosed side by side, and their table: which record shows which effect, how large; links to each.

DIR/STEM/            of each record: report.html, diagnosis.json, model.toml
DIR/report.html      the table, what matters first, and how often each effect was named
DIR/diagnoses.csv    the same for programs, and diagnoses.nc
DIR/cases.jsonl      what is done; begun again, only what is missing is diagnosed
"""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.faults import fault
from rig.many.cases import Case, Ended
from rig.many.computed import compute
from rig.many.engine import Engine, EngineChoice
from rig.many.journal import LOST, Journal, cases_in, files_of
from rig.records.record import Record, Refused, content_digest, unit_of
from rig.report.figures import both_widths, svg_text
from rig.report.many_figure import named_figure
from rig.report.page import Html, figure, link, table, write_page
from rig.report.told import MODEL, Told
from rig.version import __version__

Row = dict[str, Any]
Tell = Callable[[int, int, str, Told], None]
READ = ("temperature_degC", "resistance_ohm", "current_A")  # between what a record is: by these an odd one is seen


@dataclass(frozen=True)
class Task:
    """What is done with each record.

    work(record, asked, model's path or None, *shared) -> Told, in another process; shared: records that all need;
    files: whose contents decide what comes out, beside all these.
    document: the JSON file among the files; row: of it, for the table, whose name is `table`; rank: what stands first
    in the page; columns: of the page, by name, with their heads.
    """

    work: Callable[..., Told]
    asked: Any
    document: str
    table: str
    title: str
    row: Callable[[dict[str, Any]], Row]
    rank: Callable[[Mapping[str, Any]], Any]
    columns: Mapping[str, str]
    shared: tuple[Record, ...] = ()
    files: tuple[Path, ...] = ()

    @property
    def own_files(self) -> list[str]:
        """What stands in DIR beside the records' folders."""
        return [*files_of(self.table), "report.html"]


def each_record(
    records: Sequence[Record | Refused], task: Task, out: Path | None, choice: EngineChoice, tell: Tell
) -> tuple[list[dict[str, Any]], list[str], int]:
    """(documents in the order of the records, a line a fault, how many results of an earlier time are in `out` that are
    of none of these); tell(done, of, source, what came out) as each ends.
    Those that were refused have their faults, and their row in the table; nothing else is made of them. Raises Faults.
    """
    journal = _journal(out, records, task) if out is not None else None
    names = folders_of(records) if journal is None else [journal.case(k)["folder"] for k in range(len(records))]
    documents, faults = _known(out, names, journal, task)
    for number, record in enumerate(records):
        if isinstance(record, Refused):
            faults[number] = record.faults
            if journal is not None:
                journal.note(number, _row(record, Told(faults=record.faults), task))
    left = [number for number in range(len(records)) if number not in documents and number not in faults]

    def cases(engine: Engine) -> Iterator[Case]:
        others = [engine.share(other) for other in task.shared]
        for number in left:
            model = str(out / names[number] / MODEL) if out is not None else None
            yield Case(number, task.work, (engine.share(records[number]), task.asked, model, *others))

    def take(ended: Ended) -> None:
        source = records[ended.number].source
        found = ended.value if not ended.fault else Told(faults=(f"{source}: {ended.fault}",))
        if found.faults:
            faults[ended.number] = found.faults
        else:
            documents[ended.number] = found.document
        if out is not None and journal is not None:
            found.write_files(out / names[ended.number])
            lost = {"status": LOST, "text": ended.fault}
            row = lost if ended.fault else _row(records[ended.number], found, task)
            journal.add(ended.number, row, ended.seconds)
        tell(len(documents) + len(faults), len(records), source, found)

    try:
        compute(cases, len(left), choice, take)
    finally:
        if journal is not None:
            journal.close()
    if out is not None and journal is not None:
        _write_page(out, journal.rows(), task)
    others = journal.others if journal is not None else 0
    told = [line for k in sorted(faults) for line in faults[k]]
    return [documents[number] for number in sorted(documents)], told, others


def _row(record: Record | Refused, found: Told, task: Task) -> Row:
    """For the table: what was read, and what came out."""
    if isinstance(record, Refused):
        return {"status": "failed", "text": list(found.faults)}
    if found.faults:
        return {"status": "failed", "text": list(found.faults), **_read(record)}
    return {"status": "done", **_read(record), **task.row(found.document)}


def _read(record: Record) -> Row:
    """How much a record holds, between what, and what was taken for what."""
    time = record["time_s"]
    row: Row = {"rows": record.rows, "duration_s": float(time[-1] - time[0])}
    for name in READ:
        if record.has(name):
            finite = record[name][np.isfinite(record[name])]
            row |= {f"{name}.lowest": float(finite.min()), f"{name}.highest": float(finite.max())}
    return {**row, "read": " / ".join(record.notes)}


def _read_in_words(row: Mapping[str, Any]) -> Html:
    """The same for the page."""
    if "rows" not in row:
        return Html()
    parts = [f"{row['rows']} rows in {row['duration_s']:.4g} s"]
    for name in READ:
        if f"{name}.lowest" in row:
            parts.append(f"{row[f'{name}.lowest']:.4g} to {row[f'{name}.highest']:.4g} {unit_of(name)}")
    said = f"<details><summary>read as</summary>{escape(str(row['read']))}</details>" if row.get("read") else ""
    return Html(escape(", ".join(parts)) + said)


def folders_of(records: Sequence[Record | Refused], taken: Iterable[str] = (), known: Sequence[str] = ()) -> list[str]:
    """A folder's name for each record: the known one, else (known: "") its file's, with a number where it is taken.
    Names that differ in capitals alone are the same on some systems."""
    used = {name.casefold() for name in (*taken, *known)}
    names: list[str] = []
    for record, name in zip(records, known or [""] * len(records), strict=True):
        stem, count = Path(record.source).stem or "record", 1
        new = stem
        while not name and new.casefold() in used:
            count += 1
            new = f"{stem}_{count}"
        names.append(name or new)
        used.add(names[-1].casefold())
    return names


def _journal(out: Path, records: Sequence[Record | Refused], task: Task) -> Journal:
    """Of records that are known by what is in them, wherever they stand among the others: one that was done keeps its
    folder when others come to it, and one with other contents gets a new one. Raises Faults."""
    by_content: dict[tuple[str, str], list[Row]] = {}
    before = cases_in(out)
    for case in before:
        by_content.setdefault((str(case.get("of")), str(case.get("holds"))), []).append(case)
    of, holds = digest_of(task), [content_digest(record) for record in records]
    known = [""] * len(records)
    for spelled in (True, False):  # copies of one record: first those that are named as they were
        for k, record in enumerate(records):
            for case in by_content.get((of, holds[k]), []) if not known[k] else []:
                if str(case["folder"]) not in known and (not spelled or case.get("record") == record.source):
                    known[k] = str(case["folder"])
                    break
    names = folders_of(records, [*task.own_files, *(str(case.get("folder")) for case in before)], known)
    identities = {
        k: {"number": k, "record": record.source, "folder": names[k], "of": of, "holds": holds[k]}
        for k, record in enumerate(records)
    }
    return Journal(out, task.table, identities, same=("folder", "of", "holds"))


def digest_of(task: Task) -> str:
    """Of all that decides what comes out, beside the record."""
    read = [path.read_bytes() for path in task.files]
    of = (task.asked, __version__, [other.columns for other in task.shared], read)
    return hashlib.sha256(pickle.dumps(of)).hexdigest()[:12]


def _known(
    out: Path | None, names: Sequence[str], journal: Journal | None, task: Task
) -> tuple[dict[int, dict[str, Any]], dict[int, tuple[str, ...]]]:
    """(documents, lines of faults) of the records that are done. Raises Faults where a document is damaged."""
    documents: dict[int, dict[str, Any]] = {}
    faults: dict[int, tuple[str, ...]] = {}
    for number, (values, _) in (journal.done if journal is not None and out is not None else {}).items():
        if values.get("status") == "failed":
            faults[number] = tuple(_why(values))
        elif values.get("status") == "done" and out is not None:
            path = out / names[number] / task.document
            if not path.is_file():
                continue
            try:
                documents[number] = json.loads(path.read_text(encoding="utf-8"))
            except ValueError:
                text = "is damaged; expected what came out of its record, or a new DIR for --report"
                raise fault(path, "", text) from None
    return documents, faults


def _why(row: Mapping[str, Any]) -> list[str]:
    """The lines that say why a record has nothing: of its faults, or one of how its process ended."""
    text = row.get("text", [])
    return [text] if isinstance(text, str) else list(text)


def _write_page(out: Path, rows: Sequence[Row], task: Task) -> None:
    """DIR/report.html."""
    parts = [_table(sorted(rows, key=task.rank), task.columns)]
    done = [row for row in rows if "verdict" in row]
    if done:
        drawn = named_figure(done)
        text = svg_text(drawn)
        caption = "How often each effect was named, and each verdict reached."
        parts.insert(0, figure(both_widths(drawn, "named", text), caption))
    failed = sum(1 for row in rows if row["status"] != "done")
    write_page(
        out / "report.html", task.title, f"{len(rows)} records; of {failed} of them nothing could be said.", parts
    )


def _table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    cells: list[list[str]] = []
    for row in rows:
        record = str(row["record"])
        if row.get("status") == "done":
            own = [link(record, f"{row['folder']}/report.html"), *(_shown(row.get(name, "")) for name in columns)]
        else:  # each line of a fault begins with the record's name, which stands before it already
            why = Html("<br>".join(escape(line.removeprefix(f"{record}: ")) for line in _why(row)))
            own = [record, why, *([""] * (len(columns) - 1))]
        cells.append([*own, _read_in_words(row)])
    return table(["record", *columns.values(), "what was read"], cells, kind="words many")


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
