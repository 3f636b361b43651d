"""Text into files, whole or not at all, so that whatever fails names its file: the error of a full disk does not by
itself."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """An OSError from inside that names no file names this one."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A file that is there whole, or as it was before. Raises OSError, which names the file; what was written of the
    new one until then would take room away from the next trial."""
    new = path.with_name(path.name + ".new")
    try:
        with naming(path):
            yield new
            os.replace(new, path)
    except BaseException as error:
        with suppress(OSError):
            new.unlink()
        if isinstance(error, OSError) and error.filename == str(new):  # nobody has asked for a file of this name
            error.filename = str(path)
        raise


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """Where to write what is to be the file: beside it, and in its place at the end, so that a full disk leaves no half
    of it and takes away nothing that was there before. A link, a pipe and a device are written to as they are. Raises
    OSError, which names the file."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        with naming(path):
            yield path
    else:
        with replaced(path) as new:
            yield new


def write_text(path: Path, text: str) -> None:
    """The text as the file's content, UTF-8. Raises OSError, which names the file."""
    with written(path) as new:
        new.write_text(text, encoding="utf-8")
