"""Options of a benchmark, its cases side by side, and its results as a file."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

ROOT = Path(__file__).resolve().parent.parent
Case = TypeVar("Case")
Found = TypeVar("Found")


def options(doc: str | None, **defaults: Any) -> argparse.Namespace:
    """Parse --NAME for each default, of the default's type; a tuple stands for all choices, of which some may be asked
    for with commas between. --json FILE and --workers N are always there."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in {"workers": 2, "json": "", **defaults}.items():
        flag = f"--{name.replace('_', '-')}"
        if isinstance(default, bool):
            parser.add_argument(flag, action="store_true")
        elif isinstance(default, tuple):
            parser.add_argument(flag, type=_some_of(default), default=default, metavar=",".join(map(str, default)))
        else:
            parser.add_argument(flag, type=type(default), default=default, metavar=type(default).__name__.upper())
    return parser.parse_args()


def _some_of(choices: tuple[str, ...]) -> Callable[[str], tuple[str, ...]]:
    def some(text: str) -> tuple[str, ...]:
        found = tuple(text.split(","))
        if unknown := [one for one in found if one not in choices]:
            raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: expected some of {', '.join(choices)}")
        return found

    return some


def side_by_side(work: Callable[[Case], Found], cases: Iterable[Case], workers: int) -> Iterator[Found]:
    """Results in the order of the cases, each as soon as it is there; how many are done goes to stderr."""
    todo: Sequence[Case] = list(cases)
    with ProcessPoolExecutor(workers) as pool:
        for k, found in enumerate(pool.map(work, todo), 1):
            if sys.stderr.isatty():
                print(f"\r{k} of {len(todo)}", end="\n" if k == len(todo) else "", file=sys.stderr, flush=True)
            yield found


def kept(path: str, result: Any) -> None:
    """Write the result where --json asks for it."""
    if path:
        Path(path).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
