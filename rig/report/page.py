"""The HTML page of every report: a headline, tiles with numbers, figures, tables. One file, no script, offline."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from rig.core.file_writing import write_text
from rig.report.figures import dark_style

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
    """Text that is HTML already, such as a cell with a link."""


def link(text: str, address: str) -> Html:
    """Return a link to another report."""
    return Html(f'<a href="{escape(quote(address))}">{escape(text)}</a>')


def links(items: Iterable[tuple[str, str]]) -> str:
    """Return a paragraph of links to other reports: (text, address)."""
    return f"<p>{', '.join(link(*one) for one in items)}</p>"


def tiles(items: Iterable[tuple[str, str]]) -> str:
    """Return tiles of (number, what it is)."""
    inner = "".join(f'<div class="tile"><b>{escape(n)}</b><span>{escape(what)}</span></div>' for n, what in items)
    return f'<div class="tiles">{inner}</div>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], best: int | None = None, kind: str = "") -> str:
    """Return a table; the row `best` is set in bold. One that is wider than the window scrolls by itself, not the page.

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
    """Return a figure with its caption, which is also its text for a screen reader."""
    return f'<figure role="img" aria-label="{escape(caption)}">{svg}<figcaption>{escape(caption)}</figcaption></figure>'


def section(title: str, *parts: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{''.join(parts)}</section>"


def paragraph(text: str, kind: str = "") -> str:
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def bullets(items: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def write_page(path: Path, title: str, lead: str, parts: Iterable[str]) -> None:
    """Write a page of parts, which are HTML."""
    write_text(
        path,
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}{dark_style('figure')}</style></head><body>"
        f'<h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>{"".join(parts)}</body></html>\n',
    )
