"""Files that are no records, records with columns exchanged, pipes, a full disk: what they are is told, and where."""

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

PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\5\0\0\0\3\x84\x08\3\0\0\0"
PROSE = "Dear all,\nthe film was measured, yesterday, at noon.\nBest, X\n"


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (PNG, "a picture (PNG)"),
        ("# A rig.\n\n[bench]\ntime = 'virtual'\n", "a configuration (TOML)"),
        ("[film]\nradii = [\n    0.1,\n    0.2,\n]\n", "a model file (TOML)"),
        ('{"time_s": [0, 1], "temperature_degC": [20, 21]}', "a JSON file"),
        ("<!DOCTYPE html>\n<html><body>\n<p>1, 2</p>\n</body></html>\n", "an HTML or XML page"),
    ],
)
def test_no_table_is_told_as_what_it_is(peltier: Peltier, tmp_path: Path, content: str | bytes, kind: str) -> None:
    file = tmp_path / "record.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    err = peltier.fails("identify", file)
    (line,) = err.splitlines()
    assert line.startswith(f"{file}: this is no table of numbers: {kind}")


def test_a_table_with_a_fault_is_still_a_table(peltier: Peltier, tmp_path: Path) -> None:
    file = tmp_path / "record.csv"
    for text, said in (
        ("t_s,T_K,R_ohm\n", "line 1: no row of numbers below it"),
        (PROSE, "line 1: no row of numbers below it"),
        ("plate voltage,plate power\n0,1\n1,2\n", "column 'temperature_degC' missing"),
    ):
        file.write_text(text)
        err = peltier.fails("identify", file)
        assert said in err
        assert "no table" not in err


def test_many_wrong_rows_are_counted(peltier: Peltier, tmp_path: Path) -> None:
    file = tmp_path / "record.csv"
    head = "time_s,temperature_degC,resistance_ohm\n"
    for rows, said in (
        ([f"{k},20,-5" for k in range(248)], "line 2: resistance_ohm: -5.0: expected > 0 (248 such rows, to line 249)"),
        ([f"{248 - k if k else 0},20,5" for k in range(248)], "expected increasing times (246 such rows, to line 249)"),
        ([f"{k},-300,5" for k in range(248)], "(248 such rows, to line 249)"),
        (
            [f"{k},20" if 3 < k < 30 else f"{k},20,5" for k in range(248)],
            "2 fields, expected 3 (26 such lines, to line 31)",
        ),
    ):
        file.write_text(head + "\n".join(rows) + "\n")
        err = peltier.fails("identify", file)
        (line,) = err.splitlines()  # for one cause
        assert line.endswith(said), err


def test_a_unit_in_the_name_that_is_another_quantitys_is_asked_about(peltier: Peltier, tmp_path: Path) -> None:
    file = tmp_path / "record.csv"
    file.write_text("t_s,u_V,R [ohm],T_K\n" + "".join(f"{k},{k % 9},{100 + k},{300 + k % 7}\n" for k in range(60)))
    for column, unit in (("temperature_degC=u_V", "V"), ("current_A=u_V", "V"), ("temperature_degC=#3", "ohm")):
        err = peltier.fails("identify", file, "--column", column)
        ours = column.partition("=")[0]
        assert f"was typed for {ours}, and its name says {unit}, which is no unit of that" in err
    err = peltier.fails(
        "identify", file, "--column", "current_A=u_V@A"
    )  # typed against what the file says; by its number it is taken
    assert "expected another column, or --column 'current_A=#2@A' if its name is wrong" in err
    status, _, err = peltier("identify", file, "--column", "current_A=#2@A", "--column", "R=R [ohm]")
    assert status == 0, err


@pytest.mark.parametrize("words", [("diagnose",), ("run",), ("off",)])
def test_a_name_with_spaces_that_the_shell_took_apart(peltier: Peltier, tmp_path: Path, words: tuple[str, ...]) -> None:
    """Told where the whole name is there, by verbs that take one file or many; and where it is not, nothing is."""
    whole = tmp_path / "my film of today.csv"
    apart = str(whole).split(" ")
    assert "quotation" not in peltier(*words, *apart)[2]
    whole.write_text("")
    err = peltier.fails(*words, *apart)
    assert err.splitlines()[-1] == f"peltier {words[0]}: a name with spaces needs quotation marks: {str(whole)!r}"
    assert "quotation" not in peltier(*words, whole)[2]


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
