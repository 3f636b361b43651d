"""Files that are written whole or not at all, and errors that name their file, as that of a full disk does not."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Add the file's name to an OSError from inside that has none."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a new file to write to, which replaces the one at `path` at the end; after an error the old one stays and
    the new one is deleted, so that it takes no space from the next attempt. Raises OSError, which names the file."""
    new = path.with_name(path.name + ".new")
    try:
        with naming_file(path):
            yield new
            os.replace(new, path)
    except BaseException as error:
        with suppress(OSError):
            new.unlink()
        if isinstance(error, OSError) and error.filename == str(new):  # the user knows no file of this name
            error.filename = str(path)
        raise


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """Give a file to write to as `replacing` does; a link, a pipe and a device are written to as they are."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        with naming_file(path):
            yield path
    else:
        with replacing(path) as new:
            yield new


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all. Raises OSError, which names the file."""
    with writing(path) as new:
        new.write_text(text, encoding="utf-8")
