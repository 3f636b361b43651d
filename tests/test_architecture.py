"""The house's rules that neither a reviewer nor `./peltier lint` has to check: files that load, light imports."""

from __future__ import annotations

import ast
import functools
import io
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from rig.__main__ import VERBS
from rig.config.configuration import read_configuration

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("compensator", "sim", "rig")
FORBIDDEN_NAMES = {"utils", "util", "helpers", "helper", "manager", "handler", "misc", "common"}


@functools.cache
def tree(source: str) -> ast.Module:
    """A module's syntax tree, which several rules look at."""
    return ast.parse(source)


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


def trees(package: str) -> dict[Path, ast.Module]:
    """Every module of a package."""
    paths = (ROOT / package).rglob("*.py")
    return {path: tree(path.read_text(encoding="utf-8")) for path in paths}


def test_no_room_for_leftovers(root: Path) -> None:
    stems = {path.stem for package in PACKAGES for path in (root / package).rglob("*.py")}
    assert not stems & FORBIDDEN_NAMES


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_have_docstrings(root: Path, package: str) -> None:
    missing = []
    for path, module in trees(package).items():
        if not ast.get_docstring(module):
            missing.append(str(path.relative_to(root)))
        for node in module.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                trivial = isinstance(node, ast.FunctionDef) and (
                    node.name == "main" or node.name.endswith("_arguments") or len(node.body) < 4
                )
                if not trivial and not ast.get_docstring(node):
                    missing.append(f"{path.relative_to(root)}: {node.name}")
    assert not missing


def test_every_configuration_loads(root: Path) -> None:
    paths = [*(root / "configs").glob("*.toml"), *(root / "rig" / "templates").glob("*.toml")]
    assert len(paths) >= 3
    for path in paths:
        read_configuration(path)


def test_every_verb_has_its_function() -> None:
    for verb, file in VERBS.items():
        module = import_module(f"rig.command.{file}")
        assert getattr(module, verb).__doc__
        assert getattr(module, f"{verb}_arguments")


def test_the_command_line_is_light() -> None:
    code = (
        "import sys, rig.__main__ as m; m.main(['--help']);"
        "heavy = {'numpy', 'scipy', 'numba', 'matplotlib', 'control', 'pydantic', 'rich'} & set(sys.modules);"
        "sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def python(code: str) -> None:
    """A program in a process of its own; what it gives to sys.exit, if anything, is the fault."""
    done = subprocess.run([sys.executable, "-c", f"import sys; {code}"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_what_is_refused_waits_for_no_mathematics() -> None:
    words = [["diagnose", "no.csv"], ["identify", "no.csv"], ["predict", "no.toml", "no.csv"]]
    python(
        f"import rig.__main__ as m; statuses = [m.main(words) for words in {words}];"
        "heavy = {'scipy.optimize', 'sim.diagnosis.diagnose', 'rig.analysis.prediction'} & set(sys.modules);"
        "sys.exit(', '.join(sorted(heavy)) or (statuses != [2, 2, 2] and str(statuses)))"
    )


def test_statistics_are_not_loaded_for_every_run_and_diagnosis() -> None:
    """scipy.stats takes a second to load, in front of each run; scipy.special has the functions of both."""
    python(
        "import rig.experiment.session, sim.diagnosis.diagnose;"
        "sys.exit(', '.join({'scipy.stats', 'scipy.signal'} & set(sys.modules)) or 0)"
    )


def test_mathematics_never_asks_the_time() -> None:
    for package in ("compensator", "sim"):
        for path, module in trees(package).items():
            for node in ast.walk(module):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                assert not {"time", "datetime", "logging", "random"} & set(names), path
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    assert node.func.id not in ("print", "open", "input"), path


def test_numeric_constants_have_their_reason_beside_them() -> None:
    assert not [
        f"{path}:{line} {name}"
        for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
        for name, line, said in constants(path.read_text(encoding="utf-8"))
        if not said
    ]
