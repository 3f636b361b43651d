"""README and docs: pages made from docstrings are up to date, links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINKED = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
COMMAND = re.compile(r"\b(benchmark|test) +([\w/.]+)")
SHORT = re.compile(r"\*\*missed\*\*")
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```|^ {4}[^\n]*|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as code hosts make them, and those that the page sets itself."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    heads = re.findall(r"^#+\s+(.*)$", text, re.MULTILINE)
    own = re.findall(r'<a id="([^"]+)"></a>', text)
    return {re.sub(r"[^\w\- ]", "", head.strip().lower()).replace(" ", "-") for head in heads} | {*own}


def dead_links(page: Path) -> list[str]:
    dead = []
    for target in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        file, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        path = (page.parent / file).resolve() if file else page
        if not path.exists() or (anchor and path.suffix == ".md" and anchor not in anchors(path)):
            dead.append(target)
    return dead


def test_pages_of_the_programming_interface_are_up_to_date() -> None:
    run = subprocess.run(
        [sys.executable, str(ROOT / "docs" / "api.py"), "--check"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, f"run `python docs/api.py`; stale: {run.stdout}{run.stderr}"


@pytest.mark.parametrize("page", LINKED, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    assert dead_links(page) == []


def test_every_figure_is_shown_and_drawn() -> None:
    figures = {path.name for path in (ROOT / "docs" / "figures").glob("*.svg")}
    shown = {
        Path(target).name
        for page in PAGES
        for target in LINK.findall(page.read_text(encoding="utf-8"))
        if target.startswith("figures/")
    }
    source = (ROOT / "docs" / "draw_figures.py").read_text(encoding="utf-8")
    drawn = {f"{key}.svg" for key in re.findall(r'^    "(\w+)": \w+,$', source, re.MULTILINE)}
    assert figures == shown == drawn


def cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip("|").split("|")]


def rows_of(text: str) -> list[list[str]]:
    """The rows of a text's tables, without their heads."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [cells(row) for row, below in zip(lines, [*lines[1:], ""], strict=True) if "---" not in row + below]


def test_what_falls_short_stands_apart_from_what_holds() -> None:
    """Nobody has to look for a missed figure among sixty others."""
    text = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    short, holds = (rows_of(section) for section in text.split("\n## ")[1:])
    assert short
    assert all(SHORT.search(row[3]) for row in short)
    assert not any(SHORT.search(row[3]) for row in holds)


def test_every_measured_figure_has_a_command_and_a_date() -> None:
    rows = rows_of((ROOT / "docs" / "measured.md").read_text(encoding="utf-8"))
    assert rows
    assert [row for row in rows if not COMMAND.search(row[4]) or not re.fullmatch(r"20\d\d-\d\d-\d\d", row[5])] == []


def test_the_readme_claims_nothing_that_is_not_measured() -> None:
    """Claim, what was asked, and the figure are those of docs/measured.md (which says more behind a semicolon)."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    claimed = rows_of(re.split(r"^## ", readme.split("\n## What was measured")[1], flags=re.MULTILINE)[0])
    measured = {row[1]: row for row in rows_of((ROOT / "docs" / "measured.md").read_text(encoding="utf-8"))}
    assert claimed
    for claim, asked, figure, _ in claimed:
        assert measured[claim][2] == asked
        assert measured[claim][3].startswith(figure.partition(":")[0])


def test_measured_figures_name_commands_that_are_there() -> None:
    text = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    named = {each for code in CODE.findall(text) for each in COMMAND.findall(code)} - {("benchmark", "NAME")}
    there = {"benchmark": lambda what: ROOT / "benchmarks" / f"{what}.py", "test": lambda what: ROOT / what}
    assert named
    assert [what for verb, what in sorted(named) if not there[verb](what).exists()] == []


def test_each_decision_is_whole_and_listed_once() -> None:
    text = (ROOT / "docs" / "decisions.md").read_text(encoding="utf-8")
    index, *rest = re.split(r'^<a id="d(\d+)"></a>\n', text, flags=re.MULTILINE)
    entries = dict(zip(rest[::2], rest[1::2], strict=True))
    assert sorted(re.findall(r"\(#d(\d+)\)", index), key=int) == list(entries)
    for number, entry in entries.items():
        assert entry.startswith(f"## {number}. ")
        parts = re.findall(r"^\*(Context|Decision|Consequence)\.\*", entry, re.MULTILINE)
        assert parts == ["Context", "Decision", "Consequence"], number
        assert len(entry.split()) <= 140, f"decision {number} is no summary any more"


def test_comments_point_to_decisions_in_force() -> None:
    """A reader of the code who follows a number to a decision that is gone, or is another one now, is misled."""
    there = set(re.findall(r'<a id="d(\d+)"></a>', (ROOT / "docs" / "decisions.md").read_text(encoding="utf-8")))
    sources = [path for room in ("compensator", "sim", "rig", "benchmarks") for path in (ROOT / room).rglob("*.py")]
    named = [n for path in sources for n in re.findall(r"decisions\.md, (\d+)", path.read_text(encoding="utf-8"))]
    assert named
    assert set(named) <= there


def test_a_dead_link_would_be_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    found = '# A word\n<a id="own"></a>\n[here](#a-word) [there](#own) [far](https://example.org)\n'
    page.write_text(f"{found}[gone](#another) [file](missing.md)\n")
    assert dead_links(page) == ["#another", "missing.md"]
