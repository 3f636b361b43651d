"""Reports of many cases: records diagnosed or identified side by side, the figure of a sweep, effects over months.

DIR/STEM/            of each record: report.html, diagnosis.json, model.toml
DIR/report.html      the table, what matters first, and how often each effect was named
DIR/diagnoses.csv    the same for programs, and diagnoses.nc
DIR/cases.jsonl      what is done; begun again, only what is missing is computed
"""

from __future__ import annotations

import hashlib
import json
import pickle
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.dates import date2num
from matplotlib.figure import Figure

from rig.analysis.trend import Series
from rig.batch import LOST, Case, Ended, Engine, EngineChoice, Journal, cases_in, compute, files_of
from rig.core.faults import fault
from rig.core.file_writing import naming_file
from rig.records.record import Record, Refused, content_digest, unit_of
from rig.report import page
from rig.version import __version__

Row = dict[str, Any]
OnDone = Callable[[int, int, str, "RecordReport"], None]
MODEL = "model.toml"
CANDIDATE = "candidate.toml"  # the model with what was found and is not named, to be tried
CHANNELS = ("temperature_degC", "resistance_ohm", "current_A")  # whose range is in the table: an odd record shows there
ERRORS = (("rms_dec", "RMS error, decades"), ("rms_K", "RMS error, K"), ("film_rmse_dec", "RMSE of the film, decades"))
MOST_PANELS = 6  # of a sweep's figure, side by side
MOST_SERIES = 10  # of a trend, one above the other, each still tall enough to be read
SEEN_OFTEN = 0.2  # of the runs: an effect that was named more seldom gets a line of the table and no panel


@dataclass(frozen=True)
class RecordReport:
    """What is reported of a record. document: the JSON; lines: for people; files: of the report, by name; faults: lines
    on why there is nothing."""

    document: dict[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    files: dict[str, bytes] = field(default_factory=dict)
    faults: tuple[str, ...] = ()

    def write_files(self, folder: Path) -> None:
        """Write the files into a folder, which is made. Raises OSError, which names the file."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with naming_file(path):
                path.write_bytes(content)


def files_in(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files below a folder, by their relative paths."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@dataclass(frozen=True)
class Task:
    """What to do with each of many records.

    work(record, options, model's path or None, *shared) -> RecordReport, in another process; shared: records that all
    need; files: whose contents also decide the result. document: the JSON file among the report's files; row(document):
    the row of the table, whose name is `table`; rank(row): order on the page; columns: of the page, name -> heading.
    """

    work: Callable[..., RecordReport]
    options: Any
    document: str
    table: str
    title: str
    row: Callable[[dict[str, Any]], Row]
    rank: Callable[[Mapping[str, Any]], Any]
    columns: Mapping[str, str]
    shared: tuple[Record, ...] = ()
    files: tuple[Path, ...] = ()


def each_record(
    records: Sequence[Record | Refused], task: Task, report: Path | None, choice: EngineChoice, on_done: OnDone
) -> tuple[list[dict[str, Any]], list[str], int]:
    """Do a task with each record, and write the table and the page of all into `report`. Raises Faults.

    on_done(done, of, source, report) is called as each ends. A refused record has its faults, and its row in the table.
    Returns the documents in the order of the records, a line for each fault, and how many earlier results in `report`
    are of none of these records.
    """
    with tempfile.TemporaryDirectory() as scratch:
        out = report if report is not None else Path(scratch)
        journal = _journal(out, records, task)
        documents, faults = _known(journal, task)
        for number, record in enumerate(records):
            if isinstance(record, Refused):
                faults[number] = record.faults
                journal.note(number, _row(record, RecordReport(faults=record.faults), task))
        left = [number for number in range(len(records)) if number not in documents and number not in faults]

        def cases(engine: Engine) -> Iterator[Case]:
            others = [engine.share(other) for other in task.shared]
            for number in left:
                model = str(out / journal.identities[number]["folder"] / MODEL) if report is not None else None
                yield Case(number, task.work, (engine.share(records[number]), task.options, model, *others))

        def take(ended: Ended) -> None:
            record = records[ended.number]
            found = ended.value if not ended.fault else RecordReport(faults=(f"{record.source}: {ended.fault}",))
            if found.faults:
                faults[ended.number] = found.faults
            else:
                documents[ended.number] = found.document
            found.write_files(out / journal.identities[ended.number]["folder"])
            row = {"status": LOST, "text": ended.fault} if ended.fault else _row(record, found, task)
            journal.add(ended.number, row, ended.seconds)
            on_done(len(documents) + len(faults), len(records), record.source, found)

        try:
            compute(cases, len(left), choice, take)
        finally:
            journal.close()
        if report is not None:
            _write_records_page(report, journal.rows(), task)
    lines = [line for k in sorted(faults) for line in faults[k]]
    return [documents[number] for number in sorted(documents)], lines, journal.others


def _row(record: Record | Refused, found: RecordReport, task: Task) -> Row:
    """Return a record's row of the table: its size and range, how its columns were read, and the result."""
    read: Row = {}
    if isinstance(record, Record):
        read = {"rows": record.rows, "duration_s": float(np.ptp(record["time_s"]))}
        for name in CHANNELS:
            if record.has(name):
                finite = record[name][np.isfinite(record[name])]
                read |= {f"{name}.lowest": float(finite.min()), f"{name}.highest": float(finite.max())}
        read["read"] = " / ".join(record.notes)
    if found.faults:
        return {"status": "failed", "text": list(found.faults), **read}
    return {"status": "done", **read, **task.row(found.document)}


def folders_of(records: Sequence[Record | Refused], taken: Iterable[str] = (), known: Sequence[str] = ()) -> list[str]:
    """Return a folder's name for each record: the known one, else (known: "") its file's, with a number if it is taken.
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
    """Return the journal of records that are identified by their contents. Raises Faults.

    A record that was done keeps its folder when others are added, and one with other contents gets a new folder.
    """
    by_content: dict[tuple[str, str], list[Row]] = {}
    before = cases_in(out)
    for case in before:
        by_content.setdefault((str(case.get("of")), str(case.get("holds"))), []).append(case)
    of, holds = digest_of(task), [content_digest(record) for record in records]
    known = [""] * len(records)
    for spelled in (True, False):  # copies of one record: first those whose names are as they were
        for k, record in enumerate(records):
            for case in by_content.get((of, holds[k]), []) if not known[k] else []:
                if str(case["folder"]) not in known and (not spelled or case.get("record") == record.source):
                    known[k] = str(case["folder"])
                    break
    taken = [*files_of(task.table), "report.html", *(str(case.get("folder")) for case in before)]
    names = folders_of(records, taken, known)
    identities = {
        k: {"number": k, "record": record.source, "folder": names[k], "of": of, "holds": holds[k]}
        for k, record in enumerate(records)
    }
    return Journal(out, task.table, identities, same=("folder", "of", "holds"))


def digest_of(task: Task) -> str:
    """Return a digest of all that decides the result, apart from the record."""
    read = [path.read_bytes() for path in task.files]
    of = (task.options, __version__, [other.columns for other in task.shared], read)
    return hashlib.sha256(pickle.dumps(of)).hexdigest()[:12]


def _known(journal: Journal, task: Task) -> tuple[dict[int, dict[str, Any]], dict[int, tuple[str, ...]]]:
    """Return documents and faults of the records that are done. Raises Faults for a damaged document."""
    documents: dict[int, dict[str, Any]] = {}
    faults: dict[int, tuple[str, ...]] = {}
    for number, (values, _) in journal.done.items():
        path = journal.folder / str(journal.identities[number]["folder"]) / task.document
        if values.get("status") == "failed":
            faults[number] = tuple(_why(values))
        elif values.get("status") == "done" and path.is_file():
            try:
                documents[number] = json.loads(path.read_text(encoding="utf-8"))
            except ValueError:
                text = "is damaged; expected what came out of its record, or a new DIR for --report"
                raise fault(path, "", text) from None
    return documents, faults


def _why(row: Mapping[str, Any]) -> list[str]:
    """Return the lines on why a record has no result: its faults, or how its process ended."""
    text = row.get("text", [])
    return [text] if isinstance(text, str) else list(text)


def _write_records_page(out: Path, rows: Sequence[Row], task: Task) -> None:
    """Write DIR/report.html: a row for each record, what matters first."""
    parts = [_records_table(sorted(rows, key=task.rank), task.columns)]
    if judged := [row for row in rows if "verdict" in row]:
        drawn = _verdict_figure(judged)
        caption = "How often each effect was named, and each verdict reached."
        parts.insert(0, page.figure(page.both_widths(drawn, "named", page.svg_text(drawn)), caption))
    failed = sum(1 for row in rows if row["status"] != "done")
    lead = f"{len(rows)} records; of {failed} of them nothing could be said."
    page.write_page(out / "report.html", task.title, lead, parts)


def _records_table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    cells: list[list[str]] = []
    for row in rows:
        record = str(row["record"])
        if row.get("status") == "done":
            found = [row.get(name, "") for name in columns]
            shown = [f"{value:.4g}" if isinstance(value, float) else str(value) for value in found]
            own = [page.link(record, f"{row['folder']}/report.html"), *shown]
        else:  # each line of a fault begins with the record's name, which stands before it already
            why = page.Html("<br>".join(escape(line.removeprefix(f"{record}: ")) for line in _why(row)))
            own = [record, why, *([""] * (len(columns) - 1))]
        cells.append([*own, _read_in_words(row)])
    return page.table(["record", *columns.values(), "what was read"], cells, kind="words many")


def _read_in_words(row: Mapping[str, Any]) -> page.Html:
    if "rows" not in row:
        return page.Html()
    parts = [f"{row['rows']} rows in {row['duration_s']:.4g} s"]
    for name in CHANNELS:
        if f"{name}.lowest" in row:
            parts.append(f"{row[f'{name}.lowest']:.4g} to {row[f'{name}.highest']:.4g} {unit_of(name)}")
    notes = f"<details><summary>read as</summary>{escape(str(row['read']))}</details>" if row.get("read") else ""
    return page.Html(escape(", ".join(parts)) + notes)


def draw_sweep(rows: Sequence[Row], path: Path) -> Path | None:
    """Write the figure of a table of cases; return None if the table has nothing to show."""
    if any("verdict" in row for row in rows):
        drawn = _verdict_figure([row for row in rows if "verdict" in row])
    else:
        found = next(((name, label) for name, label in ERRORS if any(name in row for row in rows)), None)
        if found is None:
            return None
        drawn = _error_figure(rows, *found)
    page.write_svg(path, page.svg_text(drawn))
    return path


def _error_figure(rows: Sequence[Row], error: str, label: str) -> Figure:
    """Draw an error over each parameter that was varied, a colour for each set of effects."""
    done = [row for row in rows if error in row]
    # the columns of numbers before the results that take more than one value
    before = [name for name in list(done[0])[: list(done[0]).index("status")] if name not in ("number", "seed", "of")]
    numbers = [name for name in before if all(isinstance(row.get(name), (int, float)) for row in done)]
    names = [name for name in numbers if len({row[name] for row in done}) > 1][:MOST_PANELS] or ["number"]
    kinds = list(dict.fromkeys(row.get("effects", "") for row in done))
    drawn, panels = page.new_figure(len(names), 1.2 + 2.6 * len(names), share=False)
    colours = list(dict.fromkeys(page.COLOURS.values()))
    for axes, name in zip(panels, names, strict=True):
        for k, kind in enumerate(kinds):
            points = [(row[name], row[error]) for row in done if row.get("effects", "") == kind]
            x, y = np.array(points, float).T
            colour = colours[k % len(colours)]
            axes.plot(x, y, ".", color=colour, alpha=0.6, label=kind or "no effect")
            values = np.unique(x)
            if 1 < values.size <= max(12, x.size // 3):
                axes.plot(values, [np.median(y[x == v]) for v in values], color=colour)
        axes.set_xlabel(name)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
    if len(kinds) > 1:
        drawn.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8)
    return drawn


def _verdict_figure(rows: Sequence[Row]) -> Figure:
    """Draw how many cases have which effect, and which verdict."""
    effects = Counter(word.partition(":")[0] for row in rows for word in str(row["named"]).split())
    verdicts = Counter(str(row["verdict"]) for row in rows)
    bars = [(name, count, page.COLOURS["measured"]) for name, count in effects.most_common()]
    bars += [(f"verdict: {name}", count, page.COLOURS["instrument_pid"]) for name, count in verdicts.most_common()]
    drawn, (axes,) = page.new_figure(1, 1.2 + 0.35 * len(bars))
    names, counts, colours = zip(*reversed(bars), strict=True)
    axes.barh(names, counts, color=colours)
    axes.set_xlabel(f"cases of {len(rows)}")
    axes.locator_params(axis="x", integer=True)  # nobody has a quarter of a case
    return drawn


def write_trend_report(out: Path, series: Sequence[Series], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write out/report.html and out/trend.svg: which rig shows which effect, how large, since when.

    rows: of the runs, with "link", the address of the run's report.
    """
    changed = [one for one in series if one.change is not None]
    lead = f"{len(changed)} of {len(series)} effects changed." if changed else "No effect changed."
    shown = [one for one in series if one.change is not None or one.seen >= SEEN_OFTEN * len(one.at)][:MOST_SERIES]
    parts = []
    if shown:
        drawn = _series_figure(shown)
        text = page.svg_text(drawn)
        page.write_svg(out / "trend.svg", text)
        caption = "Sizes over time with their 95 % intervals; a vertical line where one changed, its means before and "
        parts.append(page.figure(page.both_widths(drawn, "trend", text), caption + "after."))
    cells = []
    for row in rows:
        name = page.link(str(row["run"]), str(row["link"])) if row.get("link") else str(row["run"])
        verdict = str(row.get("verdict", row.get("text", "")))
        cells.append((name, str(row["at"])[:16].replace("T", " "), str(row["rig"]), verdict, str(row.get("named", ""))))
    runs = page.table(("run", "began, UTC", "rig", "verdict", "named"), cells, kind="words")
    parts += [page.section("Effects", _effects(series)), page.section("Runs", runs)]
    page.write_page(out / "report.html", "Trend", lead, parts)


def _series_figure(series: Sequence[Series]) -> Figure:
    """Draw each series over the days, one above the other."""
    drawn, panels = page.new_figure(len(series), 1.0 + 1.9 * len(series))
    for axes, one in zip(panels, series, strict=True):
        days: Any = date2num(np.array([at[:19] for at in one.at], dtype="datetime64[s]"))  # type: ignore[no-untyped-call]
        below, above = (abs(one.value - one.low), abs(one.high - one.value))
        axes.errorbar(days, one.value, (below, above), fmt="o", ms=3, lw=1, color=page.COLOURS["measured"])
        if (change := one.change) is not None:
            axes.axvline(days[change.since], color=page.COLOURS["model"])
            for (mean, _), span in ((change.before, days[: change.since]), (change.after, days[change.since :])):
                page.draw_line(axes, span, np.full(span.size, mean), color=page.COLOURS["model"], lw=1)
        axes.set_title(f"{one.rig}: {one.effect}", loc="left", fontsize=9)
        axes.set_ylabel(one.parameter)
        axes.xaxis_date()
    drawn.autofmt_xdate()
    return drawn


def _effects(series: Sequence[Series]) -> str:
    head = ("rig", "effect", "since", "before", "after", "latest", "named in")
    cells = []
    for one in series:
        row = one.row()
        latest = f"{row['latest']:.4g} ({row['low']:.4g} to {row['high']:.4g})" if "latest" in row else ""
        values = [f"{row[key]:.4g}" if key in row else "" for key in ("before", "after")]
        since = f"{row['since'][:16].replace('T', ' ')} {row['change']}" if row["since"] else "no change"
        cells.append((one.rig, f"{one.effect} {one.parameter}", since, *values, latest, f"{one.seen} of {len(one.at)}"))
    return page.table(head, cells) if cells else page.paragraph("No effect was named in any run.")
