"""What is reported of a record, as values: computed anywhere, written where it is wanted."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.core.file_writing import naming_file

MODEL = "model.toml"
CANDIDATE = "candidate.toml"  # the model with what was found and is not named, to be tried


@dataclass(frozen=True)
class Told:
    """document: the JSON; lines: for people; files: of the report, by name; faults: why there is nothing."""

    document: dict[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    files: dict[str, bytes] = field(default_factory=dict)
    faults: tuple[str, ...] = ()

    def write_files(self, folder: Path) -> None:
        """The files of the report into its folder, which is made. Raises OSError, which names the file."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with naming_file(path):
                path.write_bytes(content)


def files_in(folder: Path) -> dict[str, bytes]:
    """By name, as paths below the folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }
