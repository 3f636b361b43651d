"""The HTML page of every report: a headline, tiles with numbers, figures, tables. One file, no script, offline."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from rig.core.file_writing import write_text
from rig.report.figures import dark_style

if TYPE_CHECKING:
    from rig.report.run_rows import RunRows

STYLE = """
:root { color-scheme: light dark; --ink: #1c2330; --soft: #5b6577; --line: #dfe3ea; --paper: #ffffff; --tile: #f5f7fa;
        --accent: #1f5fbf; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e8ee; --soft: #a3adbb; --line: #323a47; --paper: #14181f; --tile: #1d232d; --accent: #8ab4f8; } }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; color: var(--ink);
       background: var(--paper); margin: 0 auto; max-width: 1080px; padding: 28px 20px 60px; }
a { color: var(--accent); }
h1, p, li { overflow-wrap: anywhere; } h1 { font-size: 1.6rem; margin: 0 0 .2rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; }
p.lead { font-size: 1.1rem; margin: .3rem 0 1.2rem; } p.note, figcaption { color: var(--soft); font-size: .92rem; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(165px, 1fr)); gap: 10px; }
.tile { background: var(--tile); border: 1px solid var(--line); border-radius: 10px; padding: 10px 14px; }
.tile b { display: block; font-size: 1.2rem; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.tile span { color: var(--soft); font-size: .88rem; }
figure { margin: 1rem 0 0; } figure svg { width: 100%; height: auto; display: block; }
.in-narrow { display: none; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 6px 10px; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; } tr.best td { font-weight: 600; }
.words th, .words td { text-align: left; vertical-align: top; }
.many td { min-width: 8rem; overflow-wrap: anywhere; }
ul { padding-left: 1.2rem; } code { background: var(--tile); padding: 1px 5px; border-radius: 5px; }
@media (max-width: 640px) {
  body { padding: 16px 14px 40px; } h1 { font-size: 1.3rem; } p.lead { font-size: 1rem; }
  .in-wide { display: none; } .in-narrow { display: block; }
  .tiles { grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); }
  th, td { padding: 5px 7px; font-size: .88rem; } }
"""


class Html(str):
    """Text that is HTML already: a cell with a link."""


def facts(run: RunRows) -> str:
    """When, on what, with what, and how it ended: the line under a report's headline."""
    start, stop = run.document["start"], run.document.get("stop", {})
    instruments = ", ".join(f"{one['maker']} {one['model']}" for one in start["instruments"].values())
    simulated = start["settings"]["bench"]["controller"]["port"].startswith("sim://")
    off = "output off, confirmed" if stop.get("output_off_confirmed") else "OUTPUT NOT CONFIRMED OFF"
    ended = f"Ended: {stop.get('reason', '?')}, {off}." if stop else "Nobody wrote down how it ended."
    where = "SIMULATED rig" if simulated else "real rig"
    text = f"{start['at'][:16].replace('T', ' ')} UTC, {where}: {instruments}. {ended}"
    return paragraph(f"{text} {punctuality(stop.get('ticks', {}))}".strip(), "note")


def punctuality(ticks: Mapping[str, float]) -> str:
    """How punctual a run was: ticks done and missed, and the longest time without a reading with a current on."""
    if not ticks:
        return ""
    text = f"{ticks['done']} ticks, {ticks['missed']} missed, at most {1e3 * ticks['latest_s']:.0f} ms late"
    if "unwatched_s" in ticks:
        gaps = f", {ticks['gaps']} gap{'s' * (ticks['gaps'] > 1)}" if ticks["gaps"] else ""
        text += f"; longest time without a reading with a current on {ticks['unwatched_s']:.2f} s{gaps}"
    if count := ticks.get("unacknowledged"):
        text += f"; {count} command{'s' * (count > 1)} not acknowledged"
    return text + "."


def link(text: str, address: str) -> Html:
    """A link to another report."""
    return Html(f'<a href="{escape(quote(address))}">{escape(text)}</a>')


def links(items: Iterable[tuple[str, str]]) -> str:
    """Links to other reports: (text, address)."""
    return f"<p>{', '.join(link(*one) for one in items)}</p>"


def tiles(items: Iterable[tuple[str, str]]) -> str:
    """Numbers with what they are."""
    inner = "".join(f'<div class="tile"><b>{escape(n)}</b><span>{escape(what)}</span></div>' for n, what in items)
    return f'<div class="tiles">{inner}</div>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], best: int | None = None, kind: str = "") -> str:
    """A table; the row `best` is set in bold. One that is wider than the window scrolls by itself, not the page.
    kind: "words" of a table of words, which stand at the left; "words many" of one with wide columns."""
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join(
        f"<tr{' class=best' if k == best else ''}>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>"
        for k, row in enumerate(rows)
    )
    inner = f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="{f"wide {kind}".strip()}">{inner}</div>'


def _cell(cell: str) -> str:
    return cell if isinstance(cell, Html) else escape(cell)


def figure(svg: str, caption: str) -> str:
    """A figure with its caption; the caption is also its text for a screen reader."""
    return f'<figure role="img" aria-label="{escape(caption)}">{svg}<figcaption>{escape(caption)}</figcaption></figure>'


def section(title: str, *parts: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{''.join(parts)}</section>"


def paragraph(text: str, kind: str = "") -> str:
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def bullets(items: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def write_page(path: Path, title: str, lead: str, parts: Iterable[str]) -> None:
    """Write the page."""
    write_text(
        path,
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}{dark_style('figure')}</style></head><body>"
        f'<h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>{"".join(parts)}</body></html>\n',
    )
