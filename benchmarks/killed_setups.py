"""A set-up that is killed at a random moment: does the next command come up, and what does `off` say meanwhile?

    ./peltier benchmark killed_setups [--count 20] [--seed 1]

Clones the committed state of this repository into a temporary folder, again for each of the set-ups; they take the
packages from pip's cache, or uv's where it is there. In turn the launcher alone is killed, all its processes are, or
Ctrl-C comes. At once `off` for a port that is not there has to end with 11 and no traceback; then the same command as
before has to come up, with every package. At the end two set-ups of one clone run at the same time.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CONTROLLER = '[bench.controller]\ndriver = "meerstetter"\nport = "/dev/no_such_port"\n'
UNLIKE = {"prometheus-client": "prometheus_client", "pyserial": "serial", "tomli-w": "tomli_w"}  # the module's name
WAYS = ("launcher killed", "all killed", "Ctrl-C")


@contextlib.contextmanager
def cloned() -> Iterator[Path]:
    """A clone of its own, whose processes are ended with it."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as temporary:
        clone = Path(temporary) / "peltier-rig"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        (clone / "away.toml").write_text(CONTROLLER)
        try:
            yield clone
        finally:
            for process in Path("/proc").iterdir():
                with contextlib.suppress(OSError, ValueError):
                    if (process / "cwd").resolve() == clone:
                        os.kill(int(process.name), signal.SIGKILL)  # it compiles
            shutil.rmtree(clone, ignore_errors=True)


def begun(clone: Path) -> subprocess.Popen[str]:
    """The set-up, as a process group of its own."""
    return subprocess.Popen(
        [str(clone / "peltier"), "--version"],
        cwd=clone.parent,
        env=environment(clone),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def environment(clone: Path) -> dict[str, str]:
    left = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PELTIER", "NUMBA"))}
    return {**left, "PELTIER_SOCKET": str(clone / "none.sock")}


def end(process: subprocess.Popen[str], way: str) -> None:
    if way == "launcher killed":
        process.kill()
    else:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL if way == "all killed" else signal.SIGINT)


def off_says(clone: Path) -> tuple[int, str]:
    """Exit status and words of `off`, in a set-up that was interrupted."""
    words = [str(clone / "peltier"), "off", "away.toml"]
    done = subprocess.run(words, cwd=clone, env=environment(clone), capture_output=True, text=True)
    return done.returncode, done.stderr


def comes_up(clone: Path) -> str:
    """Set up again: nothing, or what went wrong."""
    process = begun(clone)
    said, _ = process.communicate()
    if process.returncode != 0:
        return f"status {process.returncode}: {said.strip()[-200:]}"
    needed = tomllib.loads((clone / "pyproject.toml").read_text())["project"]["dependencies"]
    names = [name.split(">")[0] for name in needed]
    modules = ", ".join(["rig.command.run", "rig.web.app", *(UNLIKE.get(name, name) for name in names)])
    words = [str(clone / "peltier"), "python", "-c", f"import {modules}"]
    done = subprocess.run(words, cwd=clone.parent, env=environment(clone), capture_output=True, text=True)
    return done.stderr.strip()[-200:]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it, and so would a set-up
    draw = random.Random(options.seed)
    with cloned() as clone:
        began = time.monotonic()
        wrong = comes_up(clone)
        whole_s = time.monotonic() - began
        print(f"undisturbed: {wrong or 'comes up'} in {whole_s:.1f} s", flush=True)
    up = right = 0
    for k in range(options.count):
        way, at_s = WAYS[k % len(WAYS)], draw.uniform(0.0, whole_s)
        with cloned() as clone:
            process = begun(clone)
            time.sleep(at_s)
            early = process.poll() is None
            end(process, way)
            status, said = off_says(clone)
            says = status == 11 and "OUTPUT NOT CONFIRMED OFF" in said and "Traceback" not in said
            began = time.monotonic()
            wrong = comes_up(clone)  # an installer that has outlived its launcher may be at work
            took_s = time.monotonic() - began
            process.communicate()
        up, right = up + (not wrong), right + says
        when = "" if early else " (it was done by then)"
        print(f"{way:<16} at {at_s:4.1f} s{when}: off {status}{'' if says else ' ' + said[-200:]}, ", end="")
        print(f"again: {wrong or 'comes up'} in {took_s:.1f} s", flush=True)
    with cloned() as clone:
        both = [begun(clone), begun(clone)]
        heard = [process.communicate()[0] for process in both]
        together = all(process.returncode == 0 for process in both) and sum("waiting" in one for one in heard) == 1
    print(f"come up again {up} of {options.count}; off says 11 in a line {right} of {options.count}; ", end="")
    print(f"two at the same time: {'both come up' if together else heard}")
    return 0 if up == right == options.count and together else 1


if __name__ == "__main__":
    sys.exit(main())
