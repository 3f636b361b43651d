"""The secrets of [serve] taken out of a configuration's text, before anybody is shown it or a run folder keeps it."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from rig.core.faults import Faults
from rig.files.toml_text import parsed_toml

SECRET_KEYS = ("token", "metrics_token", "webhook")  # a webhook's address is all that its receiver asks for


def without_secrets(text: str) -> str:
    """The text of a configuration without the secrets that TOML finds in it, as it was otherwise. Raises Faults.

    Where they cannot be cut out by whole lines (an inline table, a secret that a comment repeats), the text is written
    anew from what TOML makes of it, without its comments.
    """
    raw = parsed_toml(text, Path("text"))
    table = raw.get("serve")
    values = [table[key] for key in SECRET_KEYS if key in table] if isinstance(table, dict) else []
    if not isinstance(table, dict) or not values:
        return text
    cut = "".join(line for line in text.splitlines(keepends=True) if line.partition("=")[0].strip() not in _spellings())
    wanted = {**raw, "serve": {key: value for key, value in table.items() if key not in SECRET_KEYS}}
    try:
        if parsed_toml(cut, Path("text")) == wanted and not any(str(value) in cut for value in values):
            return cut
    except Faults:
        pass  # a secret of several lines: the cut left a part of it
    return tomli_w.dumps(wanted)


def _spellings() -> set[str]:
    """How a line with a secret may begin."""
    plain = {f"{table}{key}" for table in ("", "serve.") for key in SECRET_KEYS}
    return plain | {f'"{key}"' for key in SECRET_KEYS} | {f"'{key}'" for key in SECRET_KEYS}
