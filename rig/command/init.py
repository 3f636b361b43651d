"""peltier init [DIR]: commented configurations to start from; existing files are left alone."""

from __future__ import annotations

import argparse
from importlib import resources
from pathlib import Path

from rig.core.faults import Faults, fault
from rig.core.file_writing import write_text


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dir", type=Path, nargs="?", default=Path(), metavar="DIR")


def main(options: argparse.Namespace) -> int:
    folder: Path = options.dir
    templates = sorted(
        (item for item in resources.files("rig.templates").iterdir() if item.name.endswith(".toml")),
        key=lambda item: item.name,
    )
    there = [
        f"{folder / item.name}: exists; expected a new file" for item in templates if (folder / item.name).exists()
    ]
    if there:
        raise Faults(there)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise fault(folder, "", "is a file; expected a folder") from None
    except OSError as error:
        raise fault(folder, "", f"no folder can be made here: {error.strerror}") from None
    for item in templates:
        write_text(folder / item.name, item.read_text(encoding="utf-8"))
        print(folder / item.name)
    return 0
