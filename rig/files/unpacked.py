"""The bytes of a file that a logger has compressed: gzip, bzip2, xz, known by their first bytes and not by the name."""

from __future__ import annotations

import io
import zlib
from importlib import import_module
from pathlib import Path
from typing import Final

from rig.core.faults import fault

MARKS: Final = (
    (b"\x1f\x8b", "gzip"),
    (b"BZh", "bz2"),
    (b"\xfd7zXZ\x00", "lzma"),
)  # as the formats' definitions fix them
MOST_BYTES: Final = 1_000_000_000  # a record of ten million rows; zeros of that size are packed into a megabyte


def unpacked(data: bytes, path: Path) -> tuple[bytes, str]:
    """What is inside, and what packed it; the bytes themselves and "" where nothing did. Raises Faults."""
    packed_by = next((name for mark, name in MARKS if data.startswith(mark)), "")
    if not packed_by:
        return data, ""
    try:
        module = import_module(packed_by)
    except ImportError:  # a Python that was built without bz2 or lzma
        raise fault(path, "", f"compressed ({packed_by}), which this Python cannot unpack; unpack it first") from None
    try:
        with module.open(io.BytesIO(data)) as file:
            content: bytes = file.read(MOST_BYTES + 1)
    except EOFError:
        raise fault(path, "", f"compressed ({packed_by}), and cut off; expected the whole file") from None
    except (OSError, zlib.error, getattr(module, "LZMAError", OSError)) as error:
        raise fault(path, "", f"compressed ({packed_by}), and damaged: {error}") from None
    if len(content) > MOST_BYTES:
        raise fault(path, "", f"unpacks to more than {MOST_BYTES / 1e9:g} GB; expected a record")
    return content, packed_by
