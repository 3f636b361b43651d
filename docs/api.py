"""Write docs/api/*.md from the signatures and docstrings of the public names.

    python docs/api.py            writes the pages
    python docs/api.py --check    prints the names of stale pages; exit status 1 if there are any

The sources are read, not imported. A name is found in whichever file of its room defines it, so that a file may be
renamed; a name that is gone, or that two files define, is an error.
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs" / "api"


class Page(NamedTuple):
    """A page. names: "room.Name", and for a class behind a colon the methods that are shown (all, without a colon)."""

    title: str
    about: str
    names: tuple[str, ...]


PAGES: dict[str, Page] = {
    "notebook": Page(
        "import rig",
        "Records, models, diagnoses and simulations. [A notebook's hour](../python.md) is an introduction. "
        "A result prints the lines of its verb; `plot()` returns a matplotlib figure.",
        (
            "rig.notebook.read_record",
            "rig.records.Record: rows has output to_frame",
            "rig.notebook.identify",
            "rig.notebook.Identification: plot",
            "rig.notebook.predict",
            "rig.notebook.PredictedRecord: rmse_dec rmse_K plot",
            "rig.notebook.invert",
            "rig.Inversion:",
            "rig.notebook.diagnose",
            "rig.notebook.RecordDiagnosis: plot write_report",
            "rig.notebook.simulate",
            "rig.notebook.Simulation",
            "rig.simulated_rig",
            "rig.notebook.read_model",
            "rig.notebook.write_model",
            "rig.config.Model:",
            "rig.core.Faults",
        ),
    ),
    "bench": Page(
        "A bench",
        "`rig.run`, `rig.calibrate`, `rig.open_bench`, what they return, and how an experiment can end. "
        "Read [safety](../safety.md) first.",
        (
            "rig.notebook.run",
            "rig.notebook.calibrate",
            "rig.notebook.open_bench",
            "rig.notebook.OpenBench",
            "rig.notebook.BenchReading",
            "rig.notebook.Run",
            "rig.core.Outcome",
            "rig.core.Tripped",
            "rig.core.NotConfirmedOff",
            "rig.core.Stopped",
            "rig.core.Unsuitable",
        ),
    ),
    "film": Page(
        "Film, inverse, plate",
        "The mathematics without instruments: `compensator`. [The model](../model.md) explains it.",
        (
            "compensator.hysteresis.Envelope:",
            "compensator.hysteresis.Memoryless:",
            "compensator.hysteresis.Memory:",
            "compensator.hysteresis.FilmModel: initial_memory simulate step output_at order_margin",
            "compensator.inverse.Inverse: solve first solutions reachable_interval trajectory",
            "compensator.inverse.Solution",
            "compensator.thermal.PlateModel: rate_K_per_s step simulate rate_range_K_per_s current_for_rate_A",
        ),
    ),
    "law": Page(
        "The control law",
        "One step of the loop as a function: readings and targets in, a current out. "
        "[A controller of your own](../own_law.md) takes its place.",
        (
            "compensator.control.LawSettings",
            "compensator.control.Law",
            "compensator.control.Inputs",
            "compensator.control.Command",
            "rig.control.Decision:",
        ),
    ),
    "effect": Page(
        "An effect",
        "The classes that a file with an effect uses. [An effect of your own](../own_effect.md) is a complete one.",
        (
            "sim.effects.Effect:",
            "sim.effects.Parameter",
            "sim.effects.Command",
            "sim.effects.HeatFlow",
            "sim.effects.heat_term",
            "sim.effects.Filter",
            "sim.effects.Warming",
            "sim.effects.Reading",
            "sim.effects.ReadingTime",
        ),
    ),
    "driver": Page(
        "A driver",
        "What the rig asks of a driver, and what drivers share. [A driver of your own](../own_driver.md) is a complete "
        "one.",
        (
            "rig.drivers.TemperatureController",
            "rig.drivers.Status",
            "rig.drivers.Meter",
            "rig.core.Reading",
            "rig.core.Quality",
            "rig.drivers.confirmed_off",
            "rig.core.TimedOut",
            "rig.core.Corrupt",
            "rig.core.OutOfStep",
            "rig.core.Refused",
            "rig.core.Disconnected",
        ),
    ),
}
Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def definitions(room: str) -> dict[str, list[ast.ClassDef | Function]]:
    """Return the top-level classes and functions of a room's files, by name."""
    found: dict[str, list[ast.ClassDef | Function]] = {}
    for path in sorted((ROOT / room.replace(".", "/")).rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
                found.setdefault(node.name, []).append(node)
    return found


def definition(name: str) -> ast.ClassDef | Function:
    """Return what defines "room.Name"."""
    room, _, last = name.rpartition(".")
    nodes = definitions(room).get(last, [])
    if len(nodes) != 1:
        raise SystemExit(f"docs/api.py: {name}: {len(nodes)} definitions in {room.replace('.', '/')}; expected one")
    return nodes[0]


def docstring(node: ast.ClassDef | Function) -> str:
    """Return a docstring as Markdown: a section of numpydoc becomes a list."""
    text = inspect.cleandoc(ast.get_docstring(node, clean=False) or "")
    text, *sections = re.split(r"\n(\w[\w ]*)\n-{3,}\n", text)
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        items = re.split(r"\n(?=\S)", body.strip())
        lines = (re.sub(r"^([\w, *]+?) :(?:\s+|$)", r"`\1`: ", " ".join(item.split())) for item in items)
        text += f"\n{title}:\n\n" + "".join(f"- {line}\n" for line in lines)
    return text.rstrip()


def decorators(node: ast.ClassDef | Function) -> set[str]:
    return {ast.unparse(each).split("(")[0].split(".")[-1] for each in node.decorator_list}


def signature(node: Function, bound: bool) -> str:
    """Return name(arguments) -> result, one argument a line if it is long."""
    arguments = separate(node.args)
    if bound and "staticmethod" not in decorators(node):
        arguments = arguments[1:]
    result = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    line = f"{node.name}({', '.join(arguments)}){result}"
    if len(line) <= 100:
        return line
    return f"{node.name}(\n" + "".join(f"    {each},\n" for each in arguments) + f"){result}"


def separate(arguments: ast.arguments) -> list[str]:
    """Return each argument with its annotation and default."""
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


def function_text(node: Function) -> str:
    return f"## {node.name}\n\n{code(signature(node, bound=False))}\n{docstring(node)}\n"


def method_text(node: Function) -> str:
    """Return a line of a list."""
    is_property = bool(decorators(node) & {"property", "cached_property"})
    shown = f"{node.name}: {ast.unparse(node.returns)}" if is_property and node.returns else signature(node, True)
    said = " ".join(docstring(node).split())
    return f"- `{' '.join(shown.split())}`" + (f" {said}" if said else "")


def class_text(node: ast.ClassDef, shown: list[str] | None) -> str:
    """Return the class with its public fields, then its methods; shown: of which names, None: all public ones."""
    bases = ", ".join(ast.unparse(base) for base in node.bases)
    lines = [f"class {node.name}" + (f"({bases})" if bases else "")]
    for each in node.body:
        if isinstance(each, ast.AnnAssign) and not ast.unparse(each.target).startswith("_"):
            lines.append("    " + ast.unparse(each))
        elif isinstance(each, ast.FunctionDef) and each.name == "__init__":
            lines.append("    " + signature(each, bound=True).replace("__init__", node.name, 1).replace("\n", "\n    "))
    methods = [each for each in node.body if isinstance(each, (ast.FunctionDef, ast.AsyncFunctionDef))]
    if shown is None:
        shown = [each.name for each in methods if not each.name.startswith("_")]
    if missing := {*shown} - {each.name for each in methods}:
        raise SystemExit(f"docs/api.py: {node.name} has no {', '.join(sorted(missing))}")
    listed = "\n".join(method_text(each) for each in methods if each.name in shown)
    return f"## {node.name}\n\n{code(chr(10).join(lines))}\n{docstring(node)}\n" + (f"\n{listed}\n" if listed else "")


def page(contents: Page) -> str:
    parts = [f"# {contents.title}\n\n{contents.about}\n"]
    for name in contents.names:
        name, colon, methods = name.partition(":")
        node = definition(name)
        if isinstance(node, ast.ClassDef):
            parts.append(class_text(node, methods.split() if colon else None))
        else:
            parts.append(function_text(node))
    return tidy("\n".join(parts))


def contents() -> str:
    lines = ["# Programming interface", ""]
    lines += ["Reference, written by `docs/api.py` from the docstrings; do not edit. What is not here may change.", ""]
    for file, each in PAGES.items():
        names = [name.partition(":")[0].rpartition(".")[2] for name in each.names]
        lines.append(f"- [{each.title}]({file}.md): {', '.join(f'`{name}`' for name in names)}")
    return tidy("\n".join(lines))


def tidy(text: str) -> str:
    return "\n".join(line.rstrip() for line in text.rstrip().splitlines()) + "\n"


def pages() -> dict[str, str]:
    """Return what docs/api must hold: text by file name."""
    return {"README.md": contents(), **{f"{file}.md": page(each) for file, each in PAGES.items()}}


def stale() -> list[str]:
    """Return the names of pages that are missing, differ from their sources, or have none."""
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
