"""Messages in the words of whoever called: `--column 'a=b'` of the command line is `column="a=b"` in Python."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager

from rig.core.faults import Faults

KEYWORDS = {
    "first": "first_s",
    "budget": "budget_s",
    "period": "period_s",
    "effect": "effects",
    "effect-file": "effect_files",
}
CHOICES = ("cooled", "heated", "fitted", "current", "temperature")  # words that are an option's value, and no prose
FLAGS = ("reversed", "branches")
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*)(: (?=[^:]*: )|:)?(?:[= ]?('(?:[^']|'\"'\"')*'|[^\s']\S*))?")
_TWICE = re.compile(r'\b(\w+)=("[^"]*")((?: (?:and )?\1="[^"]*")+)')


def python_words(text: str) -> str:
    """Return a message with keyword arguments in place of the command line's options."""

    def keyword(found: re.Match[str]) -> str:
        name, colon, raw = found.group(1), found.group(2) or "", found.group(3) or ""
        own = KEYWORDS.get(name, name.replace("-", "_"))
        value, rest = _value(name, raw, bool(colon.strip() and colon.endswith(" ")))
        if value is not None:
            return f"{own}={value}{rest}"
        return (f"{own}=True" if name in FLAGS else own) + found.group(0).removeprefix(f"--{name}")

    def listed(found: re.Match[str]) -> str:
        values = re.findall(r'"[^"]*"', found.group(0))
        return f"{found.group(1)}=[{', '.join(values)}]"

    return _TWICE.sub(listed, _OPTION.sub(keyword, text))


def _value(name: str, raw: str, named: bool) -> tuple[str | None, str]:
    """Return an option's value as Python has it, and what follows it; None where the next word is prose. named: it
    stands between colons, behind the option that is at fault."""
    if raw.startswith("'"):
        return _quoted("".join(shlex.split(raw))), ""
    if name == "decimal" and raw in (",", "."):
        return _quoted(raw), ""
    word = raw.rstrip(",;:.)") if "..." not in raw else raw.rstrip(",;:)")
    rest = raw[len(word) :]
    if re.fullmatch(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", word):
        return word, rest
    if word and (named or "=" in word or word in CHOICES):
        return _quoted(word), rest
    return None, ""


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


@contextmanager
def in_python() -> Iterator[None]:
    """Context, and decorator: Faults that are raised in it speak Python."""
    try:
        yield
    except Faults as faults:
        raise Faults(python_words(line) for line in faults.lines) from None
