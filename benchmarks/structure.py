"""How large the packages are, and where they break the house's rules of size.

    python benchmarks/structure.py [--since COMMIT] [--list] [--json FILE]

Statements: nodes of Python's syntax tree (ast.stmt) in compensator, sim and rig; docstrings and comments do not count.
The ratio over a commit is given twice: of everything, and of the files that stood there already, followed through
renames by git (a file that was split counts as the part that git calls the same, so the second figure flatters splits).
A numeric constant is a module-level UPPER_CASE name with a number, or a collection of numbers; its reason is a comment
on its lines or on the line above.
"""

from __future__ import annotations

import argparse
import ast
import functools
import io
import json
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("compensator", "sim", "rig")
LONGEST_FUNCTION = 60  # lines, decorators not counted
LONGEST_FILE = 700  # lines; one idea a file, as long as it needs: beyond, think again
EXCUSED = {"compensator/inverse/bracket.py:common_root"}  # a split costs 6 to 14 % of the inverse
SAME_FILE = "-M40%"  # git's rename detection: what was moved and edited is the same file from 40 % of its lines on


def git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def sources_now() -> dict[str, str]:
    """Text of every module of the packages, by path."""
    paths = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


def sources_at(commit: str) -> dict[str, str]:
    """The same at a commit."""
    names = git("ls-tree", "-r", "--name-only", commit, *PACKAGES).split("\n")
    return {name: git("show", f"{commit}:{name}") for name in names if name.endswith(".py")}


@functools.cache
def tree(source: str) -> ast.Module:
    """A module's syntax tree, which several rules look at."""
    return ast.parse(source)


def statements(source: str) -> int:
    """How many statements, without docstrings."""
    nodes = [node for node in ast.walk(tree(source)) if isinstance(node, ast.stmt)]
    return sum(not _is_text(node) for node in nodes)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def long_functions(path: str, source: str) -> Iterator[tuple[str, int]]:
    """Name and lines of each function that is too long."""
    for node in ast.walk(tree(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno is not None:
            lines = node.end_lineno - node.lineno + 1
            if lines > LONGEST_FUNCTION and f"{path}:{node.name}" not in EXCUSED:
                yield f"{path}:{node.name}", lines


def constants(source: str) -> Iterator[tuple[str, int, bool]]:
    """Name and line of each numeric constant, and whether a reason stands beside it."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    comments = {token.start[0] for token in tokens if token.type == tokenize.COMMENT}
    for node in tree(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        name = ast.unparse(target)
        if name.isupper() and _is_number(node.value):
            lines = range(node.lineno - 1, (node.end_lineno or node.lineno) + 1)
            yield name, node.lineno, any(line in comments for line in lines)


def _is_number(node: ast.expr) -> bool:
    """Whether an expression is a number, arithmetic of numbers, or a collection of them."""
    parts: list[ast.expr]
    match node:
        case ast.Constant():
            return isinstance(node.value, int | float) and not isinstance(node.value, bool)
        case ast.UnaryOp():
            parts = [node.operand]
        case ast.BinOp():
            parts = [node.left, node.right]
        case ast.Tuple() | ast.List() | ast.Set():
            parts = node.elts
        case ast.Dict():
            parts = node.values
        case ast.Call():
            parts = node.args
        case _:
            return False
    return bool(parts) and all(_is_number(part) for part in parts)


def stood_already(commit: str, now: dict[str, str]) -> set[str]:
    """The files of today that git follows to a file of the commit."""
    lines = [line.split("\t") for line in git("diff", "--name-status", SAME_FILE, commit, "--", *PACKAGES).splitlines()]
    added = {words[-1] for words in lines if words[0] == "A"}
    return set(now) - added


def measured(since: str) -> tuple[dict[str, float], dict[str, list[str]]]:
    """The figures, and what stands behind each."""
    now, then = sources_now(), sources_at(since)
    size = {path: statements(source) for path, source in now.items()}
    before = sum(map(statements, then.values()))
    kept = stood_already(since, now)
    found = {
        "functions_too_long": [f"{name} {n}" for path in now for name, n in long_functions(path, now[path])],
        "files_too_long": [f"{path} {n}" for path in now if (n := len(now[path].splitlines())) > LONGEST_FILE],
        "constants_without_reason": [
            f"{path}:{line} {name}" for path in now for name, line, said in constants(now[path]) if not said
        ],
    }
    figures = {
        "statements": float(sum(size.values())),
        "statements_then": float(before),
        "ratio": sum(size.values()) / before,
        "ratio_of_files_that_stood_then": sum(n for path, n in size.items() if path in kept) / before,
        "constants": float(sum(1 for source in now.values() for _ in constants(source))),
        **{name: float(len(places)) for name, places in found.items()},
    }
    return figures, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--since", default="92ecae0", metavar="COMMIT", help="what the ratios are over")
    parser.add_argument("--list", action="store_true", help="say which functions, files and constants")
    parser.add_argument("--json", type=Path, metavar="FILE")
    asked = parser.parse_args()
    figures, found = measured(asked.since)
    for name, value in figures.items():
        print(f"{name.replace('_', ' '):34s} {value:,.{3 if 'ratio' in name else 0}f}")
        for place in found.get(name, []) if asked.list else []:
            print(f"    {place}")
    if asked.json:
        asked.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
