"""What is no file is refused at once, what a shell feeds in is read, and a full disk names the file that it cut off."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from rig.core.faults import Faults
from rig.core.file_writing import naming_file, write_text
from rig.records.record_file import read_record, write_columns
from tests.peltier import Peltier
from tests.rig.small import MODEL, no_file_above

RECORD = "time_s,temperature_degC,resistance_ohm\n" + "".join(f"{k},{20 + k},{1000 - k}\n" for k in range(60))
FULL = Path("/dev/full")

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs POSIX pipes")


@pytest.mark.parametrize("name", ["record.csv", "record.xlsx", "record.mat"])
def test_a_pipe_that_nobody_feeds_is_refused(peltier: Peltier, tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    for verb in ("identify", "diagnose"):
        status, out, err = peltier(verb, tmp_path / name)
        assert (status, out) == (2, "")
        assert err == f"{tmp_path / name}: is a device or a pipe; expected a file\n"


def test_sockets_and_devices_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # a socket's path has to be short
    with socket.socket(socket.AF_UNIX) as line:
        line.bind("s")
        for path in (Path("s"), Path("/dev/zero")):
            with pytest.raises(Faults, match="is a device or a pipe"):
                read_record(path)


def test_what_a_shell_feeds_in_is_read(tmp_path: Path, root: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    words = [sys.executable, "-m", "rig", "predict", str(tmp_path / "model.toml"), "/dev/stdin"]
    done = subprocess.run(words, input=RECORD, capture_output=True, text=True, cwd=root, check=False)
    assert done.returncode == 0, done.stderr
    assert "60 rows" in done.stdout


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_a_full_disk_names_its_file(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"No space left on device: '/dev/full'"):
        write_text(FULL, "x" * 100_000)
    with pytest.raises(OSError, match=r"No space left on device: '/dev/full'"):
        write_columns(FULL, {"note": ["x" * 100] * 1000})
    with pytest.raises(FileNotFoundError, match="other"), naming_file(tmp_path):
        (tmp_path / "other").read_text()


def test_a_file_that_is_cut_off_is_as_it_was_before(tmp_path: Path) -> None:
    old, new = tmp_path / "film.toml", tmp_path / "new.csv"
    old.write_text("a model that somebody has")
    with no_file_above(4096):
        with pytest.raises(OSError, match=f"'{old}'"):
            write_text(old, "x = 1\n" * 10_000)
        with pytest.raises(OSError, match=f"'{new}'"):
            write_columns(new, {"time_s": ["1.25"] * 10_000})
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"film.toml": "a model that somebody has"}


def test_a_link_stays_one_and_a_pipe_is_fed(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_text(tmp_path / "link", "text")
    assert ((tmp_path / "link").is_symlink(), (tmp_path / "file").read_text()) == (True, "text")
    reader, writer = os.pipe()
    write_columns(Path(f"/dev/fd/{writer}"), {"time_s": ["1.25"]})
    os.close(writer)
    with os.fdopen(reader) as fed:
        assert fed.read() == "time_s\n1.25\n"
