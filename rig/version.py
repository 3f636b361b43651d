"""The program's version, and the state of its sources."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

__version__ = "0.1.0"
PACKAGES = ("compensator", "sim", "rig")


@cache
def source_digest() -> str:
    """Sixteen hex digits that change with any source: between two releases a version number says nothing of bits."""
    root, digest = Path(__file__).resolve().parents[1], hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
