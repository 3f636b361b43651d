"""The diagnosis of one tree of sources in a process of its own, that is handed records and asked what it says."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

# Reads the path of a pickled record on each line, leaves the document and the seconds beside it, and says so.
PROGRAM = """
import json, pickle, sys, time
from numba.core import event
from sim.diagnosis.diagnose import diagnose
for line in sys.stdin:
    path = line.strip()
    with open(path, "rb") as file:
        columns, options = pickle.load(file)
    compiled = []
    with event.install_timer("numba:compile", compiled.append):
        began = time.process_time()
        try:
            document, fault = diagnose(columns, **options).document(), None
        except Exception as error:
            document, fault = None, repr(error)
        worked_s = time.process_time() - began
    answer = {"document": document, "fault": fault, "cpu_s": worked_s - sum(compiled), "compiled_s": sum(compiled)}
    with open(sys.argv[1], "w") as file:
        json.dump(answer, file, default=float)
    print("answered", file=sys.__stdout__, flush=True)
"""


class Program:
    """The sources in `tree`, with one thread; files: a folder for what is handed over; more: of its environment."""

    def __init__(self, tree: Path, files: Path, more: Mapping[str, str] = MappingProxyType({})) -> None:
        files.mkdir(exist_ok=True)
        self.record, self.said = files / "record.pickle", files / "said.json"
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(self.said)],
            cwd=tree,
            env={**os.environ, **one_thread, "PYTHONPATH": str(tree), **more},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, columns: Mapping[str, Any], options: Mapping[str, Any]) -> None:
        """Hand over a record; the answer may be waited for later."""
        self.record.write_bytes(pickle.dumps((dict(columns), dict(options))))
        stdin: IO[str] = self.process.stdin  # type: ignore[assignment]
        stdin.write(f"{self.record}\n")
        stdin.flush()

    def answer(self) -> dict[str, Any]:
        """document (None and the fault where it failed), cpu_s without compiled_s. RuntimeError where it has ended."""
        stdout: IO[str] = self.process.stdout  # type: ignore[assignment]
        for line in stdout:
            if line.strip() == "answered":
                found: dict[str, Any] = json.loads(self.said.read_text())
                return found
        raise RuntimeError(f"the program ended with {self.process.wait()}")

    def end(self) -> None:
        """It is told nothing more."""
        self.process.kill()
        self.process.wait()
