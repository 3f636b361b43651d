"""The cache of compiled loops: what it gives is always of the sources as they are, and nothing that is wrong with it
ends a program. Each test has its loops in files of its own, and programs that call them."""

from __future__ import annotations

import hashlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

CALLER = """
import sys
import compensator
import compensator.compiled as compiled
from compensator.compiled import cfunc, njit
import callee
from callee import scaled
compiled.FEW = 0
compensator.listeners.append(lambda text: print(text, file=sys.stderr))

@njit
def doubled(x):
    return 2.0 * scaled(x)

@cfunc("float64(float64)")
def negative(x):
    return -scaled(x)

if __name__ == "__main__":
    import ctypes
    print(doubled(1.0), negative.ctypes(1.0), sum(doubled.stats.cache_misses.values()))
"""
CALLEE = """
from typing import NamedTuple
from compensator.compiled import njit
FACTOR = 3.0

def shift(x):
    "Not compiled by itself."
    return x + helper(x)

def helper(x):
    return 0.0 * x

@njit
def scaled(x):
    return FACTOR * x

@njit
def shifted(x):
    return x
"""


@pytest.fixture
def run(tmp_path: Path, root: Path) -> Callable[..., tuple[str, str]]:
    """Run the caller: (stdout, stderr); more: of its environment."""
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE)

    def called(**more: str) -> tuple[str, str]:
        environment = {**os.environ, "PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(tmp_path / "cache"), **more}
        # -B: Python itself takes a source of the same length and second for the one that it has compiled
        command = [sys.executable, "-B", str(tmp_path / "caller.py")]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip(), done.stderr

    return called


def files(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache").glob("*.nbc"))


def test_what_is_compiled_is_compiled_once(run: Callable[..., tuple[str, str]], tmp_path: Path) -> None:
    """And a line says so, once: seconds of silence look like a program that hangs."""
    out, err = run()
    assert out == "6.0 -3.0 1"
    assert err.count("compiling numerical code at its first use") == 1
    assert run(PYTHONHASHSEED="7") == ("6.0 -3.0 0", "")
    assert len(files(tmp_path)) == 3


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:20],
        lambda content: content[:-7],
        lambda content: content[:-1] + bytes([content[-1] ^ 1]),
        lambda content: os.urandom(len(content)),
        lambda content: hashlib.sha256(b"other").digest() + b"other",
        lambda content: hashlib.sha256(pickle.dumps((1, 2))).digest() + pickle.dumps((1, 2)),  # another numba's, whole
    ],
)
def test_damaged_files(run: Callable[..., tuple[str, str]], tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    """After a power cut files are empty or cut short; every verb ended in numba's EOFError until they were deleted."""
    run()
    for path in files(tmp_path):
        path.write_bytes(damage(path.read_bytes()))
    assert run()[0] == "6.0 -3.0 1"
    assert run() == ("6.0 -3.0 0", "")


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("return FACTOR * x", "return FACTOR + 4.0 * x", "14.0 -7.0 1"),  # the code of a callee in another file
        ("FACTOR = 3.0", "FACTOR = 5.0", "10.0 -5.0 1"),  # a constant that it reads
        ("return FACTOR * x", "return shifted(x)", "2.0 -1.0 1"),  # another callee
        ("@njit\ndef scaled", "@njit(fastmath=True)\ndef scaled", "6.0 -3.0 1"),  # how it is compiled
        ("def shift(x):", "def shift(x): # a comment", "6.0 -3.0 0"),  # nothing that is compiled
    ],
)
def test_other_sources_are_never_served(
    run: Callable[..., tuple[str, str]], tmp_path: Path, before: str, after: str, expected: str
) -> None:
    """With numba's own cache in a folder of the user's, a loop went on calling what its callees had been."""
    run()
    path = tmp_path / "callee.py"
    path.write_text(path.read_text().replace(before, after))
    assert run()[0] == expected


FIELDS = """
from typing import NamedTuple
from compensator.compiled import njit

class Inner(NamedTuple):
    a: float
    b: float

@njit
def first(pair):
    return pair.a

print(first(Inner(1.0, 2.0)))
"""


def test_fields_of_a_named_tuple_in_another_order(run: Callable[..., tuple[str, str]], tmp_path: Path) -> None:
    """numba's name of the argument's type is the same; the place in memory is another."""
    (tmp_path / "caller.py").write_text(FIELDS)
    assert run()[0] == "1.0"
    (tmp_path / "caller.py").write_text(FIELDS.replace("    a: float\n    b: float", "    b: float\n    a: float"))
    assert run()[0] == "2.0"


def test_nothing_can_be_kept_and_it_computes(run: Callable[..., tuple[str, str]], tmp_path: Path) -> None:
    """In a container or for a service account; a line names the variable to set."""
    (tmp_path / "file").write_text("")
    out, err = run(NUMBA_CACHE_DIR=str(tmp_path / "file" / "below"))
    assert out == "6.0 -3.0 1"
    assert err.count("compiled loops cannot be kept") == 1
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("more", [{"NUMBA_DISABLE_JIT": "1"}, {"NUMBA_CACHE_LOCATOR_CLASSES": "nonsense"}])
def test_numbas_own_variables_end_nothing(run: Callable[..., tuple[str, str]], more: dict[str, str]) -> None:
    """Set for a user's other programs, they ended ours in a traceback."""
    assert run(**more)[0] == "6.0 -3.0 1"


def test_processes_at_once(tmp_path: Path, root: Path) -> None:
    """Each with loops of other argument types: numba gave two of them one file."""
    (tmp_path / "many.py").write_text(
        "import sys\nimport numpy as np\nfrom compensator.compiled import njit\n\n"
        "@njit\ndef total(x):\n    return x.sum()\n\n"
        "print(total(np.arange(4).astype(sys.argv[1])), sum(total.stats.cache_misses.values()))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    kinds = ("f4", "f8", "i4", "i8")
    for misses in ("1", "0"):
        begun = [
            subprocess.Popen(
                [sys.executable, str(tmp_path / "many.py"), kind], stdout=subprocess.PIPE, text=True, env=environment
            )
            for kind in kinds
        ]
        out = [process.communicate()[0].split() for process in begun]
        assert out == [["6.0", misses], ["6.0", misses], ["6", misses], ["6", misses]]
    assert len(files(tmp_path)) == len(kinds)


def test_every_loop_goes_through_it(root: Path) -> None:
    """numba's own decorator with cache=True would bring its cache's faults back."""
    for package in ("compensator", "sim", "rig"):
        for path in (root / package).rglob("*.py"):
            text = path.read_text("utf-8")
            assert "cache=True" not in text or path.name == "compiled.py", path
            assert "import njit" not in text.replace("from compensator.compiled import njit", ""), path
