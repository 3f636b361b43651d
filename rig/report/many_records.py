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
from urllib.parse import quote

from rig.core.faults import fault
from rig.files.record import Record, Refused
from rig.many.cases import Case, each_ended
from rig.many.engine import EngineChoice, opened
from rig.many.journal import LOST, Journal, cases_in
from rig.report.figures import svg_text
from rig.report.many_figure import named_figure
from rig.report.page import figure, write_page
from rig.report.told import MODEL, Told
from rig.safety.signals import SignalStop
from rig.version import __version__

Row = dict[str, Any]
Tell = Callable[[int, int, str, Told], None]


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
        return ["cases.jsonl", "times.csv", "report.html", f"{self.table}.csv", f"{self.table}.nc"]


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
                journal.note(number, _row(Told(faults=record.faults), task))
    left = [number for number in range(len(records)) if number not in documents and number not in faults]
    try:
        with SignalStop(), opened(choice, max(len(left), 1)) as engine:

            def cases() -> Iterator[Case]:
                others = [engine.share(other) for other in task.shared]
                for number in left:
                    model = str(out / names[number] / MODEL) if out is not None else None
                    yield Case(number, task.work, (engine.share(records[number]), task.asked, model, *others))

            for ended in each_ended(cases(), engine):
                source = records[ended.number].source
                found = ended.value if not ended.fault else Told(faults=(f"{source}: {ended.fault}",))
                if found.faults:
                    faults[ended.number] = found.faults
                else:
                    documents[ended.number] = found.document
                if out is not None and journal is not None:
                    found.write_files(out / names[ended.number])
                    row = _row(found, task) if not ended.fault else {"status": LOST, "text": ended.fault}
                    journal.add(ended.number, row, ended.seconds)
                tell(len(documents) + len(faults), len(records), source, found)
    finally:
        if journal is not None:
            journal.close()
    if out is not None and journal is not None:
        _write_page(out, journal.rows(), task)
    others = journal.others if journal is not None else 0
    told = [line for k in sorted(faults) for line in faults[k]]
    return [documents[number] for number in sorted(documents)], told, others


def _row(found: Told, task: Task) -> Row:
    """For the table."""
    if found.faults:
        return {"status": "failed", "text": " / ".join(found.faults)}
    return {"status": "done", **task.row(found.document)}


def folders_of(records: Sequence[Record | Refused], taken: Iterable[str] = (), known: Sequence[str] = ()) -> list[str]:
    """A folder's name for each record: the known one, where there is one, else its file's, with a number where it is
    taken. Names that differ in capitals alone are the same on some systems."""
    used = {name.casefold() for name in (*taken, *known) if name}
    names: list[str] = []
    for k, record in enumerate(records):
        stem = name = Path(record.source).stem or "record"
        count = 1
        while name.casefold() in used and not (known and known[k]):
            count += 1
            name = f"{stem}_{count}"
        names.append(known[k] if known and known[k] else name)
        used.add(names[-1].casefold())
    return names


def _journal(out: Path, records: Sequence[Record | Refused], task: Task) -> Journal:
    """Of records that are known by what is in them, wherever they stand among the others: one that was done keeps its
    folder when others come to it, and one with other contents gets a new one. Raises Faults."""
    by_content: dict[tuple[str, str], list[Row]] = {}
    before = cases_in(out)
    for case in before:
        by_content.setdefault((str(case.get("of")), str(case.get("holds"))), []).append(case)
    of, holds = digest_of(task), [_digest(_content(record)) for record in records]
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


def _content(record: Record | Refused) -> Any:
    return record.faults if isinstance(record, Refused) else (record.columns, record.drive)


def _digest(of: Any) -> str:
    return hashlib.sha256(pickle.dumps(of)).hexdigest()[:12]


def digest_of(task: Task) -> str:
    """Of all that decides what comes out, beside the record."""
    read = [path.read_bytes() for path in task.files]
    return _digest((task.asked, __version__, [other.columns for other in task.shared], read))


def _known(
    out: Path | None, names: Sequence[str], journal: Journal | None, task: Task
) -> tuple[dict[int, dict[str, Any]], dict[int, tuple[str, ...]]]:
    """(documents, lines of faults) of the records that are done. Raises Faults where a document is damaged."""
    documents: dict[int, dict[str, Any]] = {}
    faults: dict[int, tuple[str, ...]] = {}
    for number, (values, _) in (journal.done if journal is not None and out is not None else {}).items():
        if values.get("status") == "failed":
            faults[number] = (str(values.get("text", "")),)
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


def _write_page(out: Path, rows: Sequence[Row], task: Task) -> None:
    """DIR/report.html."""
    parts = [_table(sorted(rows, key=task.rank), task.columns)]
    done = [row for row in rows if "verdict" in row]
    if done:
        text = svg_text(named_figure(done))
        caption = "How often each effect was named, and each verdict reached."
        parts.insert(0, figure(text[text.index("<svg") :], caption))
    failed = sum(1 for row in rows if row["status"] != "done")
    write_page(
        out / "report.html", task.title, f"{len(rows)} records; of {failed} of them nothing could be said.", parts
    )


def _table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    lines = []
    for row in rows:
        link = f'<a href="{quote(str(row["folder"]))}/report.html">{escape(str(row["record"]))}</a>'
        texts = [_shown(row.get(name, "")) for name in columns]
        if row.get("status") != "done":
            link, texts[0] = escape(str(row["record"])), str(row.get("text", ""))
        lines.append(f"<tr><td>{link}</td>" + "".join(f"<td>{escape(text)}</td>" for text in texts) + "</tr>")
    head = "".join(f"<th>{escape(text)}</th>" for text in ("record", *columns.values()))
    return f'<div class="words"><table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
