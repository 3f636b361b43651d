"""A user's own files with the names of modules beside the work: is one of them ever imported?

    ./peltier benchmark shadowed_names

Each name of Python's modules, of the installed packages' and of ours stands in the working folder, as a file or as a
folder, and leaves a mark when it is imported. Beside them the verbs run, from this checkout and as an installed
`peltier`: in the working folder, in a copy of the launcher's folder (as people work in a checkout), and with the folder
on PYTHONPATH. Asked: no mark, and the exit statuses of an empty folder.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tests.rig.small import write_bench  # noqa: E402

LAUNCHER = ROOT / "peltier"
OURS = ("rig", "sim", "compensator")
SITE = ("sitecustomize", "usercustomize")
# What Python itself, and pip's script, import before us: where PYTHONPATH names a folder, that is what was asked for.
BEFORE_US = "import re, sys; print(*sys.modules)"
COMMAND = "import re\nimport sys\nfrom peltier_command import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
STARTS_S = 200.0


def names() -> list[str]:
    """Return the names of modules that a file beside the work could have, in order."""
    found = {*sys.stdlib_module_names, *packages_distributions(), *OURS, *SITE, "pip", "pyvisa", "yaml", "__main__"}
    return sorted(name for name in found if name.isidentifier())


def strew(folder: Path, names: Sequence[str], as_folders: bool) -> Path:
    """Write a module of each name, which leaves its name in the file of marks when it is imported; the file's path."""
    marks = folder / "marks"
    for name in names:
        path = folder / name / "__init__.py" if as_folders else folder / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"with open({str(marks)!r}, 'a') as file:\n    file.write('{name}\\n')\n")
        if as_folders:
            shutil.copyfile(path, path.parent / "__main__.py")
    return marks


def marked(marks: Path) -> list[str]:
    """Return what was imported since the last call."""
    found = sorted(set(marks.read_text().split())) if marks.exists() else []
    marks.unlink(missing_ok=True)
    return found


def installed(folder: Path) -> Path:
    """Make an environment with the packages of this Python in which `peltier` is installed; the command's path."""
    subprocess.run([sys.executable, "-I", "-m", "venv", "--without-pip", str(folder)], check=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    for name in (*OURS, "peltier_command.py"):
        (packages / name).symlink_to(ROOT / name)
    (packages / "others.pth").write_text(sysconfig.get_path("purelib"))
    command = folder / "bin" / "peltier"
    command.write_text(f"#!{folder / 'bin' / 'python'}\n{COMMAND}")
    command.chmod(0o755)
    return command


def environment(folder: Path, **more: str) -> dict[str, str]:
    """Of a user who has just logged in: nothing of this process' path, and a daemon's socket of its own."""
    left = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PELTIER_PYTHON"))}
    return {**left, "PELTIER_SOCKET": str(folder / "bench.sock"), **more}


def write_work(folder: Path) -> None:
    """Write configurations: of a rig that is not there, a simulated one, one for a daemon, and a sweep."""
    path = write_bench(folder, target='["start 20 kohm", "hold 1 s"]')
    text = path.read_text()
    (folder / "sweep.toml").write_text(text + '[sweep]\n[sweep.parameters]\n"simulation.seed" = [1, 2]\n')
    (folder / "serve.toml").write_text(text + '[serve]\nport = 0\nfolder = "kept"\n')
    write_bench(folder, controller=str(folder / "no_port"), time="real")
    path.rename(folder / "away.toml")
    path.write_text(text)


def verbs(command: Path, folder: Path, more: Mapping[str, str]) -> Iterator[tuple[str, bool]]:
    """Run the verbs one after the other: each with whether it ended as it should."""
    out = Path(tempfile.mkdtemp(dir=folder))
    asked = {
        "off away.toml": 11,
        "stop": 1,
        "status": 1,
        f"run config.toml --out {out}/run": 0,
        f"sweep sweep.toml --workers 2 --out {out}/sweep": 0,
        f"report {out}/run --out {out}/report": 0,
    }
    for words, status in asked.items():
        done = subprocess.run([command, *words.split()], cwd=folder, env=more, capture_output=True, text=True)
        yield words.split()[0], done.returncode == status and "Traceback" not in done.stderr
        if done.returncode != status or "Traceback" in done.stderr:
            print(f"    {words}: {done.returncode}, asked {status}: {done.stderr[-300:]}")
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([command, "serve", "serve.toml"], cwd=folder, env=more, **quiet) as daemon:
        answers = [command, "status"]
        end_s = time.monotonic() + STARTS_S
        while subprocess.run(answers, cwd=folder, env=more, capture_output=True).returncode != 0:
            if time.monotonic() > end_s or daemon.poll() is not None:
                break
            time.sleep(0.2)
        off = subprocess.run([command, "off", "serve.toml"], cwd=folder, env=more, capture_output=True, text=True)
        daemon.terminate()
        yield "serve, off", off.returncode == 0 and daemon.wait() == 143


def main() -> int:
    bad = 0
    with tempfile.TemporaryDirectory() as temporary:
        there = Path(temporary)
        command = installed(there / "installed")
        checkout = there / "checkout"
        checkout.mkdir()
        for name in (*OURS, "requirements", ".venv"):
            (checkout / name).symlink_to((ROOT / name).resolve())
        shutil.copy(LAUNCHER, checkout)
        own = subprocess.run([sys.executable, "-I", "-c", BEFORE_US], check=True, capture_output=True, text=True)
        others = [name for name in names() if name not in (*own.stdout.split(), *SITE)]
        cases = [
            ("./peltier, beside the work", LAUNCHER, False, names()),
            ("./peltier, on PYTHONPATH", LAUNCHER, True, names()),
            ("./peltier, in its own folder", checkout / "peltier", False, [n for n in names() if n not in OURS]),
            ("installed, beside the work", command, False, names()),
            ("installed, on PYTHONPATH", command, True, others),
        ]
        for name, peltier, on_path, which in cases:
            for as_folders in (False, True):
                folder = checkout if peltier.parent == checkout else Path(tempfile.mkdtemp(dir=there))
                write_work(folder)
                marks = strew(folder, which, as_folders)
                more = environment(folder, **({"PYTHONPATH": str(folder)} if on_path else {}))
                wrong = [verb for verb, right in verbs(peltier, folder, more) if not right]
                found = marked(marks)
                kind = "folders" if as_folders else "files"
                print(f"{name:<30}{len(which)} {kind:<9}imported: {len(found)} {' '.join(found[:8])}", end="")
                print(f"   wrong status: {' '.join(wrong) or 'none'}", flush=True)
                bad += bool(found or wrong)
    return min(bad, 1)


if __name__ == "__main__":
    sys.exit(main())
