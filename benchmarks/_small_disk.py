"""A file system of a few megabytes in memory, which can be filled to the last byte, and emptied again.

Mounting needs root, or the root that a user has in a namespace of his own: `with_own_mounts` begins the program anew in
one where that is allowed.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

INSIDE = "PELTIER_BENCHMARK_OWN_MOUNTS"


def with_own_mounts() -> None:
    """Become the same program with mounts of its own, where the system lets us; else go on as we are."""
    if sys.platform != "linux" or os.environ.get(INSIDE):
        return
    for words in (["unshare", "--mount"], ["unshare", "--map-root-user", "--mount"]):
        with contextlib.suppress(OSError):
            if subprocess.run([*words, "true"], capture_output=True).returncode == 0:
                os.environ[INSIDE] = "1"
                os.execvp(words[0], [*words, sys.executable, *sys.argv])


class SmallDisk:
    """Mounted at a folder. The space that a file has already taken stays its own when the disk is filled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._ballast = folder / "ballast"

    def fill(self) -> None:
        """Leave no byte of room."""
        with self._ballast.open("ab", buffering=0) as file:
            for size in (1 << 20, 4096, 1):
                with contextlib.suppress(OSError):
                    while file.write(b"\0" * size) == size:
                        pass

    def free(self) -> None:
        """Make room again."""
        self._ballast.unlink(missing_ok=True)


@contextlib.contextmanager
def small_disk(folder: Path, size_MB: int) -> Iterator[SmallDisk | None]:
    """A disk mounted at a folder; None where this process may not mount: the folder is then an ordinary one."""
    folder.mkdir(parents=True, exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size_MB}m,nr_inodes=2000", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(command, capture_output=True).returncode == 0
    except OSError:
        mounted = False
    try:
        yield SmallDisk(folder) if mounted else None
    finally:
        if mounted:
            subprocess.run(["umount", "--lazy", str(folder)], check=False)
