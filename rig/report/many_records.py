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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from rig.core.faults import fault
from rig.files.record import Record, Refused
from rig.many.cases import Case, each_ended
from rig.many.engine import EngineChoice, opened
from rig.many.journal import LOST, Journal
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

    work(record, asked, model's path or None, *shared) -> Told, in another process; shared: records that all need.
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


def each_record(
    records: Sequence[Record | Refused], task: Task, out: Path | None, choice: EngineChoice, tell: Tell
) -> tuple[list[dict[str, Any]], list[str]]:
    """(documents in the order of the records, a line a fault); tell(done, of, source, what came out) as each ends.
    Those that were refused have their faults, and their row in the table; nothing else is made of them. Raises Faults.
    """
    names = folders_of(records)
    journal = Journal(out, task.table, _identities(records, names, task)) if out is not None else None
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
    return [documents[number] for number in sorted(documents)], [line for k in sorted(faults) for line in faults[k]]


def _row(found: Told, task: Task) -> Row:
    """For the table."""
    if found.faults:
        return {"status": "failed", "text": " / ".join(found.faults)}
    return {"status": "done", **task.row(found.document)}


def folders_of(records: Sequence[Record | Refused]) -> list[str]:
    """A folder's name for each record: its file's, with a number where two have the same."""
    names: list[str] = []
    for record in records:
        stem = name = Path(record.source).stem or "record"
        count = 1
        while name in names:
            count += 1
            name = f"{stem}_{count}"
        names.append(name)
    return names


def _identities(records: Sequence[Record | Refused], names: Sequence[str], task: Task) -> dict[int, Row]:
    """Of each case: its record, and a digest of all that decides what comes out."""
    of = pickle.dumps((task.asked, __version__, [other.columns for other in task.shared]))
    found = {}
    for number, record in enumerate(records):
        holds = record.faults if isinstance(record, Refused) else (record.columns, record.drive)
        digest = hashlib.sha256(of + pickle.dumps(holds)).hexdigest()[:12]
        found[number] = {"number": number, "record": record.source, "folder": names[number], "of": digest}
    return found


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
        link = f'<a href="{escape(str(row["folder"]))}/report.html">{escape(str(row["record"]))}</a>'
        texts = [_shown(row.get(name, "")) for name in columns]
        if row.get("status") != "done":
            link, texts[0] = escape(str(row["record"])), str(row.get("text", ""))
        lines.append(f"<tr><td>{link}</td>" + "".join(f"<td>{escape(text)}</td>" for text in texts) + "</tr>")
    head = "".join(f"<th>{escape(text)}</th>" for text in ("record", *columns.values()))
    return f'<div class="words"><table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
