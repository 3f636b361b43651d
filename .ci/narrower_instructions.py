"""Runs tests as a processor with narrower instructions would: `python .ci/narrower_instructions.py [PYTEST ARGUMENTS]`.

How many terms of a sum a processor adds at once decides its last digit, and a search with many unknowns may then end
elsewhere. numpy, both OpenBLAS libraries and numba choose the widest instructions that they find. Here they are told to
do without AVX-512, as on most processors; where there is none, with the plainest that they have. Without arguments: the
tests marked `other_processor`.
"""

import os
import platform
import sys
from pathlib import Path

import numpy

ROOT = Path(__file__).resolve().parent.parent
WIDEST = ("AVX512", "X86_V4")  # how numpy's names of instructions with AVX-512 begin
PLAINEST_BLAS = {"x86_64": "Prescott", "aarch64": "ARMV8"}


def narrower() -> dict[str, str]:
    """What the libraries are told. numpy is told no more than it has: it warns of the rest, and warnings are errors."""
    found = numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    widest = [name for name in found if name.startswith(WIDEST)]
    told = {"NUMBA_CPU_FEATURES": "", "NPY_DISABLE_CPU_FEATURES": " ".join(widest or found)}
    if widest:
        return {**told, "NUMBA_CPU_NAME": "haswell", "OPENBLAS_CORETYPE": "Haswell"}
    told["NUMBA_CPU_NAME"] = "generic"
    if platform.machine() in PLAINEST_BLAS:
        told["OPENBLAS_CORETYPE"] = PLAINEST_BLAS[platform.machine()]
    return told


if __name__ == "__main__":  # in one process: each would compile all loops for that processor
    arguments = sys.argv[1:] or ["-n", "0", "-m", "other_processor", str(ROOT / "tests" / "sim" / "diagnosis")]
    launcher = [sys.executable, str(ROOT / "peltier"), "test", *arguments]
    os.execve(sys.executable, launcher, {**os.environ, **narrower()})
