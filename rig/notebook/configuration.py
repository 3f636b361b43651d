"""A configuration for a notebook: a file, or the tables that TOML would make of one."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from os import PathLike
from pathlib import Path
from typing import Any

import tomli_w

from rig.config.toml_file import read_toml
from rig.core.faults import fault

NO_FILE = Path("configuration")  # what messages call tables that stand in no file


def tables_of(configuration: str | PathLike[str] | Mapping[str, Any]) -> tuple[Path, dict[str, Any]]:
    """Where a configuration stands, and its tables, which are the caller's own. Raises Faults."""
    if isinstance(configuration, Mapping):
        return NO_FILE, deepcopy(dict(configuration))
    if isinstance(configuration, (str, PathLike)):
        path = Path(configuration)
        return path, read_toml(path)
    raise fault("configuration", "", f"expected a file's path or tables by name, not {type(configuration).__name__}")


def text_of(tables: Mapping[str, Any]) -> str:
    """As a file would have them. Raises Faults for what no file can have."""
    try:
        return tomli_w.dumps(tables)
    except (TypeError, ValueError) as error:
        raise fault(NO_FILE, "", str(error)) from None
