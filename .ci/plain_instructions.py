"""Runs tests as a plainer processor would: `python .ci/plain_instructions.py [ARGUMENTS OF PYTEST]`.

How many terms of a sum a processor adds at once decides its last digit, and a search with many unknowns may then end
elsewhere. numpy, both OpenBLAS libraries and numba choose the widest instructions that they find; here they are told to
use the plainest that they have. Without arguments: the tests marked `other_processor`.
"""

import os
import platform
import sys
from pathlib import Path

import numpy

ROOT = Path(__file__).resolve().parent.parent
PLAINEST_BLAS = {"x86_64": "Prescott", "aarch64": "ARMV8"}


def plain() -> dict[str, str]:
    """What the libraries are told. numpy is told no more than it has: it warns of the rest, and warnings are errors.
    numba keeps what it compiles for each processor apart by itself."""
    wide = numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    told = {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NPY_DISABLE_CPU_FEATURES": " ".join(wide),
    }
    if platform.machine() in PLAINEST_BLAS:
        told["OPENBLAS_CORETYPE"] = PLAINEST_BLAS[platform.machine()]
    return told


if __name__ == "__main__":
    arguments = sys.argv[1:] or ["-m", "other_processor", str(ROOT / "tests")]
    launcher = [sys.executable, str(ROOT / "peltier"), "test", *arguments]
    os.execve(sys.executable, launcher, {**os.environ, **plain()})
