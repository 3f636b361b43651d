"""The small form of `benchmark mutated_input`: inputs made bad by bytes and by structure end in a line."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks import mutated_input
from benchmarks._mutations import mutated
from rig.__main__ import main

QUICK = {"predict", "invert", "tune", "off", "replay", "identify"}  # what needs no instruments, and takes milliseconds
COUNT = 72


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Good inputs; the work goes on among them."""
    folder, before = tmp_path_factory.mktemp("good"), Path.cwd()
    mutated_input.lay_out(folder)
    os.chdir(folder)
    yield folder
    os.chdir(before)


SLOWEST = pytest.param("identify", marks=pytest.mark.long)  # what its mutants leave whole is identified


@pytest.mark.parametrize("verb", [*sorted(QUICK - {"identify"}), SLOWEST])
def test_bad_input_ends_in_a_line(good: Path, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    statuses = []
    cases = [case for case in mutated_input.CASES if case.verb == verb]
    for number in range(COUNT // len(QUICK)):
        chance = random.Random(f"{verb} {number}")
        case = chance.choice(cases)
        words = [word.replace("OUT", "out").replace("WORD", chance.choice(mutated_input.WORDS)) for word in case.words]
        name = chance.choice(case.files)
        content = (good / name).read_bytes()
        try:
            (good / name).write_bytes(mutated(name, content, chance))
            status = main([verb, *words])
        finally:
            (good / name).write_bytes(content)
            (good / "out").unlink(missing_ok=True)
        said = capsys.readouterr().err
        assert mutated_input.wrong_with(status, said) == "", (number, words, name)
        statuses.append(status)
    assert 2 in statuses  # some were bad enough to be refused


def test_an_output_that_cannot_be_written_is_told_of_first(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for out in ("dangling", "link", "taken", "/", "x" * 300):
        assert main(["run", "config.toml", "--out", out]) == 2
        assert "expected a new folder" in (said := capsys.readouterr().err) or "cannot be made" in said
    for target in ("no/such/folder.json", "taken", "x" * 300):
        assert main(["tune", "config.toml", "--json", target]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (good / "nowhere").exists()


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
def test_numbers_that_nobody_means(
    good: Path, old: str, new: str, place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (good / "config.toml").read_text()
    assert old in text
    (good / "odd.toml").write_text(text.replace(old, new, 1))
    assert main(["run", "odd.toml", "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert place in said
    assert max(map(len, said.splitlines())) < 500
