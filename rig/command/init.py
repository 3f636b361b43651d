"""peltier init [DIR]: commented configurations to start from; existing files are left alone."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.core.faults import Faults, fault
from rig.core.file_writing import write_text

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
# The README's demo is a template, too. It stands in configs/ of a checkout; the wheel has it among the templates.
DEMO = TEMPLATES.parents[1] / "configs" / "demo.toml"


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dir", type=Path, nargs="?", default=Path(), metavar="DIR")


def main(options: argparse.Namespace) -> int:
    folder: Path = options.dir
    templates = sorted([*TEMPLATES.glob("*.toml"), *([DEMO] if DEMO.exists() else [])], key=lambda path: path.name)
    files = [folder / path.name for path in templates]
    there = [f"{file}: exists; expected a new file" for file in files if file.exists()]
    if there:
        raise Faults(there)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise fault(folder, "", "is a file; expected a folder") from None
    except OSError as error:
        raise fault(folder, "", f"no folder can be made here: {error.strerror}") from None
    for file, template in zip(files, templates, strict=True):
        write_text(file, template.read_text(encoding="utf-8"))
        print(file)
    return 0
