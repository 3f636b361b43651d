"""Writes docs/api/*.md from the signatures and docstrings of the public modules.

    python docs/api.py            writes the pages
    python docs/api.py --check    names those that are stale; exit status 1 if there are any

The sources are read, not imported. What starts with an underscore is private.
"""

from __future__ import annotations

import ast
import inspect
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs" / "api"

GROUPS: dict[str, tuple[str, ...]] = {
    "The notebook: `import rig`": (
        "rig.notebook.records",
        "rig.notebook.identification",
        "rig.notebook.prediction",
        "rig.notebook.inversion",
        "rig.notebook.diagnosis",
        "rig.notebook.simulation",
        "rig.rehearsal.simulated",
        "rig.notebook.models",
        "rig.notebook.bench",
        "rig.notebook.shown",
    ),
    "What it returns": (
        "rig.analysis.identified",
        "rig.analysis.film_numbers",
        "sim.inference.transition.transition",
        "sim.inference.quantity",
        "rig.analysis.predicted",
        "rig.analysis.prediction_error",
        "rig.analysis.inverted",
        "sim.diagnosis.result",
        "rig.config.model_file",
        "rig.core.faults",
        "rig.core.errors",
        "rig.core.outcome",
        "rig.core.reading",
    ),
    "The film": (
        "compensator.hysteresis.film",
        "compensator.hysteresis.functions",
        "compensator.hysteresis.own_functions",
        "compensator.hysteresis.play",
        "compensator.inverse.inverse",
        "compensator.inverse.branch_plan",
        "compensator.inverse.solve",
        "compensator.inverse.iteration",
        "compensator.inverse.check",
        "sim.inference.film.compression",
    ),
    "Identification": (
        "sim.inference.film.fit",
        "sim.inference.film.result",
        "sim.inference.film.rows",
        "sim.inference.readings.temperature_path",
        "sim.inference.plate.fit",
    ),
    "Control": (
        "compensator.thermal.plate",
        "compensator.control.pid",
        "compensator.control.design",
        "compensator.control.margins",
        "compensator.control.linearization",
        "compensator.control.reference_shaping",
        "compensator.control.law",
        "compensator.control.law_step",
        "compensator.control.observer",
        "compensator.control.estimator",
        "compensator.control.unknown_memory",
    ),
    "Records": (
        "rig.records.record",
        "rig.records.record_file",
        "rig.records.column_names",
    ),
    "The place to add an effect": (
        "sim.effects.effect",
        "sim.effects.heat_term",
    ),
    "The place to add an instrument": (
        "rig.drivers.controller",
        "rig.drivers.meter",
        "rig.drivers.registry",
    ),
}
COMPILED = {"njit", "lean"}
Function = ast.FunctionDef | ast.AsyncFunctionDef


def source_of(module: str) -> Path:
    return ROOT / (module.replace(".", "/") + ".py")


def modules() -> list[str]:
    """The public modules that are there, in order."""
    return [name for names in GROUPS.values() for name in names if source_of(name).is_file()]


def docstring(node: ast.Module | ast.ClassDef | Function) -> str:
    return inspect.cleandoc(ast.get_docstring(node, clean=False) or "")


def decorators(node: ast.ClassDef | Function) -> set[str]:
    return {ast.unparse(each).split("(")[0].split(".")[-1] for each in node.decorator_list}


def signature(node: Function, bound: bool) -> str:
    """name(arguments) -> result, one argument a line where it is long."""
    arguments = separate(node.args)
    if bound and "staticmethod" not in decorators(node):
        arguments = arguments[1:]
    result = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    line = f"{node.name}({', '.join(arguments)}){result}"
    if len(line) <= 100:
        return line
    return f"{node.name}(\n" + "".join(f"    {each},\n" for each in arguments) + f"){result}"


def separate(arguments: ast.arguments) -> list[str]:
    """Each argument with its annotation and default."""
    positional = [*arguments.posonlyargs, *arguments.args]
    defaults: list[ast.expr | None] = [None] * (len(positional) - len(arguments.defaults))
    parts = [argument_text(a, d) for a, d in zip(positional, [*defaults, *arguments.defaults], strict=True)]
    if arguments.vararg:
        parts.append("*" + argument_text(arguments.vararg, None))
    elif arguments.kwonlyargs:
        parts.append("*")
    parts += [argument_text(a, d) for a, d in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)]
    return [*parts, "**" + argument_text(arguments.kwarg, None)] if arguments.kwarg else parts


def argument_text(argument: ast.arg, default: ast.expr | None) -> str:
    text = argument.arg + (f": {ast.unparse(argument.annotation)}" if argument.annotation else "")
    if default is None:
        return text
    return text + (" = " if argument.annotation else "=") + ast.unparse(default)


def code(text: str) -> str:
    return f"```text\n{text}\n```\n"


def public(body: list[ast.stmt]) -> list[ast.ClassDef | Function]:
    kinds = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return [node for node in body if isinstance(node, kinds) and not node.name.startswith("_")]


def function_text(node: Function, level: str, bound: bool = False) -> str:
    is_property = bool(decorators(node) & {"property", "cached_property"})
    shown = f"{node.name}: {ast.unparse(node.returns)}" if is_property and node.returns else signature(node, bound)
    return f"{level} {node.name}\n\n{code(shown)}\n{docstring(node)}\n"


def class_text(node: ast.ClassDef) -> str:
    """The class with its fields, then its public methods."""
    bases = ", ".join(ast.unparse(base) for base in node.bases)
    lines = [f"class {node.name}" + (f"({bases})" if bases else "")]
    for each in node.body:
        if isinstance(each, ast.AnnAssign) and not ast.unparse(each.target).startswith("_"):
            lines.append("    " + ast.unparse(each))
        elif isinstance(each, ast.FunctionDef) and each.name == "__init__":
            lines.append("    " + signature(each, bound=True).replace("__init__", node.name, 1))
    parts = [f"## {node.name}\n\n{code(chr(10).join(lines))}\n{docstring(node)}\n"]
    parts += [function_text(each, "###", True) for each in public(node.body) if not isinstance(each, ast.ClassDef)]
    return "\n".join(parts)


def page(module: str) -> str:
    tree = ast.parse(source_of(module).read_text(encoding="utf-8"))
    parts = [f"# {module}\n\n{docstring(tree)}\n"]
    compiled = [node for node in public(tree.body) if decorators(node) & COMPILED]
    for node in public(tree.body):
        if node not in compiled:
            parts.append(class_text(node) if isinstance(node, ast.ClassDef) else function_text(node, "##"))
    if compiled:
        lines = [f"- `{node.name}`: {' '.join(docstring(node).split(chr(10) * 2)[0].split())}" for node in compiled]
        parts.append("## Compiled loops\n\nCalled by the above; they take arrays as they are.\n\n" + "\n".join(lines))
    return tidy("\n".join(parts))


def contents() -> str:
    lines = ["# Programming interface", "", "Written by `docs/api.py` from the docstrings; do not edit.", ""]
    for group, names in GROUPS.items():
        lines += [f"## {group}", ""]
        for name in names:
            if source_of(name).is_file():
                first = docstring(ast.parse(source_of(name).read_text(encoding="utf-8"))).split("\n\n")[0]
                lines.append(f"- [{name}]({name}.md): {' '.join(first.split()).rstrip(':')}")
        lines.append("")
    return tidy("\n".join(lines))


def tidy(text: str) -> str:
    return "\n".join(line.rstrip() for line in text.rstrip().splitlines()) + "\n"


def pages() -> dict[str, str]:
    """What docs/api must hold: text by file name."""
    return {"README.md": contents(), **{f"{name}.md": page(name) for name in modules()}}


def stale() -> list[str]:
    """Names of pages that are missing, differ from their sources, or have none."""
    wanted = pages()
    there = {path.name: path.read_text(encoding="utf-8") for path in OUT.glob("*.md")} if OUT.is_dir() else {}
    return sorted(name for name in wanted.keys() | there.keys() if wanted.get(name) != there.get(name))


def main() -> int:
    if sys.argv[1:] == ["--check"]:
        print("\n".join(stale()))
        return 1 if stale() else 0
    OUT.mkdir(exist_ok=True)
    for name in stale():
        (OUT / name).unlink(missing_ok=True)
        if name in pages():
            (OUT / name).write_text(pages()[name], encoding="utf-8")
            print(f"docs/api/{name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
