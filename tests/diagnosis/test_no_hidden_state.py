"""A search takes what is known and returns what it found: it can be repeated from where it began."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim import diagnosis
from sim.diagnosis.data.record import read_columns
from sim.diagnosis.search.both_ends import select
from sim.diagnosis.search.chain import Chain, temperature_search
from sim.effects.catalogue import catalogue
from tests.diagnosis.cases import case

PLATE, FILM = ("time_s", "temperature_degC", "current_A"), "resistance_ohm"
FILES = sorted(Path(*diagnosis.__path__).rglob("*.py"))


@pytest.mark.parametrize(
    ("effect", "read"), [("sensor_lag", PLATE), pytest.param("meter_lag", (*PLATE, FILM), marks=pytest.mark.long)]
)
def test_a_search_leaves_what_it_was_given(effect: str, read: tuple[str, ...]) -> None:
    columns = case("one", 3, effect=effect, rows=1000).columns
    record = read_columns({name: columns[name] for name in read})
    first = temperature_search(record, catalogue())
    given = Chain(first.channel.record, catalogue(), first, as_read=record)
    said: list[str] = []
    (chain, names), (again, same) = select(given, said.append), select(given, said.append)
    assert names == same == {effect}
    assert chain.score(names) == again.score(names)
    assert said[: len(said) // 2] == said[len(said) // 2 :]
    assert not first.fits
    assert not given.found.searches
    assert given.facts is None
    assert given.record is first.channel.record


def rebound(tree: ast.Module) -> Iterator[str]:
    """What is assigned to an attribute anywhere but where an object is made."""
    made = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and node.name == "__init__"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store | ast.Del) and id(node) not in made:
            yield f"line {node.lineno}: {ast.unparse(node)}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_no_object_of_a_diagnosis_is_rebound(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert list(rebound(tree)) == []
    thawed = [
        node.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        and any(ast.unparse(d) in ("dataclass", "dataclass()") for d in node.decorator_list)
    ]
    assert thawed == []
