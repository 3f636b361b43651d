"""Inputs made bad by bytes and by structure end in a line: in no traceback, signal, or undocumented status."""

from __future__ import annotations

import copy
import csv
import io
import os
import random
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from rig.__main__ import main
from tests.rig.small import MODEL

CONFIGURATION = """[bench]
time = "virtual"
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
nplc = 1.0
[limits]
temperature_degC = [10, 95]
current_A = 4.0
polarity_share = 0.0
[experiment]
kind = "{kind}"
target = {target}
model = "model.toml"
period_s = 0.1
settle_s = 0.5
[control]
ms = 1.4
[simulation]
first_degC = 60.0
seed = 1
[simulation.film]
kind = "preisach"
relays = 20
[[simulation.effects]]
name = "film_lag"
tau_s = 2.0
[serve]
port = 0
token = "a token of many letters"
"""
COLUMNS = ("--column=WORD",)
CASES = [  # verb, words, files that are made bad
    ("predict", ("model.toml", "record.csv", "--out", "out"), ("model.toml", "record.csv")),
    ("predict", ("model.toml", "record.csv", "--initial", "fitted", *COLUMNS), ("model.toml", "record.csv")),
    ("invert", ("model.toml", "target.csv", "--out", "out"), ("model.toml", "target.csv")),
    ("invert", ("model.toml", "target.csv", "--limits=WORD"), ("model.toml", "target.csv")),
    ("tune", ("config.toml",), ("config.toml", "model.toml")),
    ("off", ("config.toml",), ("config.toml",)),
    ("replay", ("run",), ("run/run.json", "run/record.csv", "run/events.jsonl", "run/config.toml", "run/model.toml")),
    ("identify", ("record.csv", "--out", "out", "--operators=WORD"), ("record.csv",)),
]
EACH = 12  # mutants of a verb
DIGITS = "9" * 5000
NUMBERS = ["0", "-1", "1e308", "1e-320", "1e999", "nan", "-inf", DIGITS, "0x" + "f" * 40, "1,5", "é", "/", "\\u0000"]
WORDS = ["0", "-1", "1e308", "nan", DIGITS, "", "é", "a=b", "temperature_degC=T@K", "-50,200"]
VALUES: list[Any] = [
    *(0, -1, 10**12, -(2**63), 1e308, 5e-324, float("nan"), -float("inf"), True, "", "\0", "a" * 100_000, "/dev/zero"),
    *([], {}, [2, 1], [1e308, -1e308], ["a"], [[]], [0.0] * 5000, {"a": 1}, [{"name": "x"}]),
]
JUNK = [b"\0", b"\xff", b"\xef\xbb\xbf", b"\r", b'"', b"[" * 3000, b"a." * 3000 + b"a=1\n", b",", b"=", b"x" * 200_000]


def by_bytes(content: bytes, chance: random.Random) -> bytes:
    """Cut, doubled, inserted, overwritten, in another order or encoding."""
    at, wide, junk = chance.randrange(len(content) + 1), chance.choice([1, 2, 8, 60, 400]), chance.choice(JUNK)
    lines = content.split(b"\n")
    chance.shuffle(lines)
    return chance.choice(
        [
            content[:at],
            content[at:],
            content[:at] + content[at + wide :],
            content[:at] + content[at : at + wide] * 50 + content[at + wide :],
            content[:at] + junk + content[at:],
            content[:at] + chance.randbytes(wide) + content[at + wide :],
            b"\n".join(lines),
            content.decode().encode(chance.choice(["utf-16", "cp037", "utf-8-sig"]), "replace"),
            content.replace(b"\n", chance.choice([b"\r\n", b"\r", b"", b"\x0b"])),
            b"",
        ]
    )


def in_toml(content: bytes, chance: random.Random) -> bytes:
    """One entry of the tables inside each other: another value, another name, or gone."""
    tree = tomllib.loads(content.decode())
    places, left = [], [tree]
    while left:
        holder: Any = left.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            places.append((holder, key))
            if isinstance(holder[key], dict | list):
                left.append(holder[key])
    holder, key = chance.choice(places)
    way = chance.randrange(5)
    if way <= 2:
        holder[key] = copy.deepcopy(chance.choice(VALUES))
    elif way == 3 or isinstance(holder, list):
        del holder[key]
    else:
        holder[f"{key}{chance.choice(['x', '.', ' '])}"] = holder.pop(key)
    return tomli_w.dumps(tree).encode("utf-8", "surrogatepass")


def in_table(content: bytes, chance: random.Random) -> bytes:
    """Cells, a whole column, or the number of columns."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    way, column = chance.randrange(4), chance.randrange(len(rows[0]))
    for row in rows[1:] if way == 1 else [chance.choice(rows) for _ in range(chance.choice([1, 5, 200]))]:
        if way <= 1 and row:
            row[min(column, len(row) - 1)] = chance.choice(NUMBERS)
        else:
            row[:] = [*row[:column], *row[column + way - 1 :]]
    text = io.StringIO()
    csv.writer(text, delimiter=chance.choice(",,;\t"), lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "surrogatepass")


def mutated(name: str, content: bytes, chance: random.Random) -> bytes:
    """A file made bad in one of the ways that go with its name."""
    own = {"toml": in_toml, "csv": in_table}.get(name.rpartition(".")[2])
    return by_bytes(content, chance) if own is None or chance.random() < 0.35 else own(content, chance)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Good inputs; the work goes on among them."""
    folder, before = tmp_path_factory.mktemp("good"), Path.cwd()
    (folder / "model.toml").write_text(MODEL + '[[effects]]\nname = "film_lag"\ntau_s = 2.0\n')
    track = '["start 20 kohm", "hold 1 s", "ramp to 15 kohm at 0.5 dec/s"]'
    (folder / "config.toml").write_text(CONFIGURATION.format(kind="track_resistance", target=track))
    current = CONFIGURATION.format(kind="current_profile", target='["start 0 A", "ramp to 1 A in 4 s"]')
    (folder / "current.toml").write_text(current)
    rows = [f"{t},{60 + 0.2 * t:.3f},{20_000 - 50 * t}" for t in range(20)]
    (folder / "target.csv").write_text("time_s,setpoint_degC,target_ohm\n" + "\n".join(rows) + "\n")
    os.chdir(folder)
    assert main(["simulate", "current.toml", "--out", "record.csv"]) == 0
    assert main(["run", "config.toml", "--out", "run"]) in (0, 10)
    (folder / "taken").mkdir()
    (folder / "taken" / "file").write_text("")
    (folder / "link").symlink_to("taken")
    (folder / "dangling").symlink_to("nowhere")
    yield folder
    os.chdir(before)


SLOWEST = pytest.param("identify", marks=pytest.mark.long)  # what its mutants leave whole is identified


@pytest.mark.parametrize("verb", ["invert", "off", "predict", "replay", "tune", SLOWEST])
def test_bad_input_ends_in_a_line(good: Path, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever has a broken file is told what is wrong with it, and sees no traceback."""
    statuses = []
    for number in range(EACH):
        chance = random.Random(f"{verb} {number}")
        _, words, files = chance.choice([case for case in CASES if case[0] == verb])
        name, word = chance.choice(files), chance.choice(WORDS)
        content = (good / name).read_bytes()
        try:
            (good / name).write_bytes(mutated(name, content, chance))
            statuses.append(main([verb, *(each.replace("WORD", word) for each in words)]))
        finally:
            (good / name).write_bytes(content)
            (good / "out").unlink(missing_ok=True)
        said = capsys.readouterr().err
        assert "Traceback" not in said
        assert statuses[-1] in (0, 1, 2, 10, 11, 75), (number, words, name)
        assert said.strip() or statuses[-1] != 2, (number, words, name)
    assert 2 in statuses  # some were bad enough to be refused


def test_an_output_that_cannot_be_written_is_told_of_first(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for out in ("dangling", "link", "taken", "/", "x" * 300):
        assert main(["run", "config.toml", "--out", out]) == 2
        assert "expected a new folder" in (said := capsys.readouterr().err) or "cannot be made" in said
    for target in ("no/such/folder.json", "taken", "x" * 300):
        assert main(["tune", "config.toml", "--json", target]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (good / "nowhere").exists()
    assert (good / "taken" / "file").read_text() == ""


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("settle_s = 0.5", "settle_s = 1e9", "experiment.settle_s"),
        ("polarity_share = 0.0", "polarity_share = 1e-320", "limits.polarity_share"),
        ("period_s = 0.1", "period_s = 1e-9", "experiment.period_s"),
        ("period_s = 0.1", "period_s = 3.0", "at most 1, half of limits.stale_s"),
        ("[bench.meter]", "[bench.meter]\naverage = 60", "bench.meter.average: 60: expected at most 50, for readings"),
        ("nplc = 1.0", "nplc = 60.0", "bench.meter.nplc: 60: expected at most 50, for readings of 1 s"),
        ("current_A = 4.0", "current_A = 1e308", "limits.current_A"),
        ("seed = 1", f"seed = {'9' * 5000}", "digits"),
        ("seed = 1", f"seed = 0x{'f' * 5000}", "64 bits"),
        ("seed = 1", "seed = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("seed = 1", "seed" + ".a" * 3000 + " = 1", "nested too deeply"),
        ('port = "sim://"', 'port = "/dev/tty\\u0000"', "bench.controller.port"),
        ('"hold 1 s"', '"hold 1e300 s"', "experiment.target[1]"),
        ('"hold 1 s"', '"sine 0.1 dec period 1e-9 s for 1e3 s"', "experiment.target[1]"),
    ],
)
def test_absurd_numbers(good: Path, old: str, new: str, place: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = (good / "config.toml").read_text()
    assert old in text
    (good / "odd.toml").write_text(text.replace(old, new, 1))
    assert main(["run", "odd.toml", "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert place in said
    assert max(map(len, said.splitlines())) < 500
