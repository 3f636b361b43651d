"""The tests that take most of a minute each, which the README's test command leaves out.

    ./peltier benchmark long_tests [ARGUMENTS OF PYTEST]

They are marked `long`: mostly effects beside films of another kind, whose search has hundreds of unknowns. As a
processor with narrower instructions would run them: `.ci/narrower_instructions.py -m long tests`. Each has twenty
minutes: those beside films in steps take five on a computer that does something else besides.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    command = [sys.executable, str(ROOT / "peltier"), "test", "--dist", "worksteal", "-m", "long", "--durations=0"]
    command.append("--timeout=1200")
    return subprocess.call([*command, *sys.argv[1:], str(ROOT / "tests")])


if __name__ == "__main__":
    sys.exit(main())
