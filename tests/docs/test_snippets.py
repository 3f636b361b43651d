"""Every command and every block of Python, TOML and JSON in README and docs is run as it is printed.

Whoever copies a line and gets an error stops reading. The blocks of one page run in order, in one folder, and each sees
what those above it made. A command is not run where its comment says "not run by the tests" and why, where a reader
sees it; a block that is neither a command nor one of the languages above is output, names or mathematics, and has to
follow a command or be listed in OTHER.

What a page asks of its reader is done by `Bench` below, and nothing else: ports are set to sim:// where the page
rehearses, experiment.model is set where it says so, the records that it begins with are there. Numbers of ports are
free ones, and the rehearsal's ramps are fast.
"""

from __future__ import annotations

import glob
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
import tomllib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

import rig
from rig.__main__ import VERBS, main
from rig.config.configuration import configuration_of
from rig.config.tables import SweepFile
from rig.overview import Overview
from rig.records.record_file import write_columns
from tests.docs.test_pages import PAGES, ROOT, name
from tests.rig.small import write_bench
from tests.sim.diagnosis.plate_record import levels, record

BLOCK = re.compile(
    r"^```(?P<language>\w*)\n(?P<fenced>.*?)^```|(?P<indented>(?:^ {4}[^\n]*\n)(?:\n*^ {4}[^\n]*\n)*)", re.M | re.S
)
COMMAND = re.compile(
    r"^(?:\$ )?(?:\.{0,2}/)?(?:\.venv/bin/)?(?:peltier|python|pip|sed|lewis|sqlite3|export|curl|systemctl)\b"
)
NOT_RUN = re.compile(r"#.*not run by the tests: \S+|\(not run by the tests: \S+")
LASTING = ("serve", "emulate", "epics", "overview")  # verbs that go on until they are stopped
OTHER = {  # indented blocks that are for reading: a page's name and how the block begins
    "docs/diagnosis.md": ["Explained: the heat sink warms up"],
    "docs/epics.md": ["epics RIG ca"],
    "docs/many.md": ["Meerstetter TEC-1091"],
    "docs/own_driver.md": ["def _ask"],
    "docs/own_effect.md": ["dT_p/dt"],
    "docs/records.md": ["--column OURS", "film: transition", "temperature_degC: rows 367"],
    "docs/targets.md": ["rig.toml: experiment.target"],
    "docs/model.md": ["hand moves", "v rises", "u = ", "C dT/dt"],
}
WRITTEN = [page for page in PAGES if "api" not in page.parts]
UNTESTED = ("docs/decisions.md", "docs/measured.md")  # what was done and measured once: no page to type from


@dataclass
class Block:
    """A block of a page: its language ("" where it is indented), its text, its line, and the paragraph before it."""

    language: str
    text: str
    line: int
    before: str

    @property
    def saved_as(self) -> str | None:
        """The file that the reader saves it as: the paragraph above ends with its name."""
        found = re.search(r"`([\w.]+\.\w+)`:\s*\Z", self.before)
        return found[1] if found and self.language else None


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    end = 0
    for found in BLOCK.finditer(text):
        if found["fenced"] is None and text[: found.start()][-2:] != "\n\n":
            continue  # a paragraph of a list
        inner = found["fenced"] if found["fenced"] is not None else re.sub(r"^ {4}", "", found["indented"], flags=re.M)
        yield Block(found["language"] or "", inner, text[: found.start()].count("\n") + 1, text[end : found.start()])
        end = found.end()


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Bench:
    """The reader of one page, at a checkout."""

    def __init__(self, page: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.page, self.folder, self.capsys = name(page), folder, capsys
        self.names: dict[str, Any] = {"__name__": "page"}
        self.lasting: list[subprocess.Popen[str]] = []
        self.printed = ""  # by the last command, lines joined
        self.places = {"5024": str(free_port()), "8765": str(free_port()), "8780": str(free_port())}
        for entry in ("configs", "docs"):
            (folder / entry).symlink_to(ROOT / entry)

    # ---- what a page asks of its reader ---------------------------------------------------------

    def prepare(self, line: str) -> None:
        """Do what the page says has to be there before a command."""
        line = line.partition("#")[0].strip()
        if " rig.toml" in line and not Path("rig.toml").exists():
            self.simulated_rig()
        if re.search(r"run rig\.toml$", line):
            text = Path("rig.toml").read_text()
            Path("rig.toml").write_text(re.sub(r"^# model = .*$", 'model = "film_a/MODEL.toml"', text, flags=re.M))
        if "/dev/pts/3" in line and "/dev/pts/3" not in self.places:
            self.use_terminals()
        for path in re.findall(r"(?<![\w/.])(?:\w+/)?[\w*]+\.csv", line.partition("--out")[0]):
            self.write_record(path, "identify film.csv" in line or "mirror" in path)
        if re.search(r"\bmodel\.toml", line):
            shutil.copy("report/model.toml", "model.toml")  # what the page wrote
        if "bath.toml" in line:
            shutil.copy(ROOT / "docs" / "bath.py", "bath.py")
        if "trend runs/" in line:
            self.write_bench(Path("made"), "current_profile")
            assert main(["run", "made/bench.toml", "--out", "runs/first"]) == 0
        if " reset " in line:  # after a trip, or a stop
            assert main(["stop"]) == 0
        if "lab.toml" in line:
            benches = [{"name": "left", "address": f"http://127.0.0.1:{self.places['8765']}"}]
            Path("lab.toml").write_text(
                tomli_w.dumps({"overview": {"port": int(self.places["8780"])}, "bench": benches})
            )
        if "sweep CONFIG" in line:
            self.write_bench(Path(), "current_profile", "[sweep]\nseeds = 2\n").rename("CONFIG")

    def write_bench(self, folder: Path, kind: str, more: str = "") -> Path:
        """A configuration of a run that takes a moment."""
        folder.mkdir(exist_ok=True)
        path = write_bench(folder, target='["start 1 A", "hold 8 s"]', more=more)
        path.write_text(path.read_text().replace("track_resistance", kind))
        return path.rename(folder / "bench.toml")

    def simulated_rig(self) -> None:
        """A rig.toml for `serve`: both ports sim://, at free ports of this computer."""
        assert main(["init", "made"]) == 0
        text = Path("made/simulated.toml").read_text().replace('"virtual"', '"real"')
        ports = f"ca_port = {free_port()}\npva_port = {free_port()}\n"
        Path("rig.toml").write_text(f"{text}\n[serve]\nport = {self.places['8765']}\n[epics]\n{ports}")

    def rehearse(self, folder: Path) -> None:
        """Set both ports of init's rig.toml to sim://, with a film and ramps that do not take the evening."""
        text = (folder / "rig.toml").read_text()
        for old, new in (
            (r'"/dev/ttyUSB[01]"', '"sim://"'),
            (r"^temperature_degC = \[25, 90\]", "temperature_degC = [48, 75]"),
            (r"^period_s = 0.25", "period_s = 0.5"),
            (r"^dwell_s = 6.0", "dwell_s = 1.0"),
            (r'^    "sine .*$', ""),
        ):
            text, count = re.subn(old, new, text, flags=re.M)
            assert count, old
        (folder / "rig.toml").write_text(text)

    def use_terminals(self) -> None:
        """Write the names that `emulate` printed where the page's are."""
        printed = dict(line.split()[::2] for line in self.first_lines(2))
        self.places |= {"/dev/pts/3": printed["controller"], "/dev/pts/4": printed["meter"]}
        assert main(["init", "made"]) == 0
        text = Path("made/rig.toml").read_text()
        text = text.replace("/dev/ttyUSB0", printed["controller"]).replace("/dev/ttyUSB1", printed["meter"])
        Path("rig.toml").write_text(text)

    def write_record(self, path: str, film: bool) -> None:
        """A record of a plate (of a film, where the page goes on with one), or a target."""
        if Path(path).exists() or glob.glob(path):
            return
        columns: dict[str, Any] = record(25.0, levels(len(path), 6), len(path))
        if path == "target.csv":
            columns = {"time_s": np.arange(2.0), "target_ohm": np.array([3e4, 1e4])}
        elif path == "log.csv":
            columns = {
                "t": columns["time_s"],
                "T_K": columns["temperature_degC"] + 273.15,
                "pwm": 100 * columns["current_A"],
            }
            columns["pwm"] = np.abs(columns["pwm"])
        elif film:
            degC = 60.0 + 25.0 * np.sin(np.arange(300.0) / 20.0)
            of_degC = {"temp": degC, "R": 10.0 ** (4.0 - np.tanh(0.2 * (degC - 62.0)))}
            if path == "mirror.csv":
                of_degC = {"temperature_degC": degC, "transmission_percent": 40.0 - 20.0 * np.tanh(0.2 * (degC - 62.0))}
            columns = {"time_s": np.arange(300.0), **of_degC}
        elif self.page == "README.md":
            tables = rig.simulated_rig()
            target = ["start 1.1 A", "hold 60 s", "sine 1.5 A period 240 s for 180 s"]
            tables["experiment"] = {"kind": "current_profile", "period_s": 0.5, "target": target}
            columns = dict(rig.simulate(tables).record.columns)
        for one in ("evening/a.csv", "evening/b.csv") if "*" in path else (path,):
            Path(one).parent.mkdir(exist_ok=True)
            write_columns(Path(one), columns)

    # ---- running --------------------------------------------------------------------------------

    def command(self, line: str) -> None:
        """One line of a block, as a shell takes it."""
        line = re.sub(r" \[[^\]]*(\[[^\]]*\])?[^\]]*\]", "", line.removeprefix("$ "))  # optional parts of a synopsis
        for part in re.split(r" && ", line):
            if part.startswith("./"):  # in the checkout's folder, where all pages begin
                os.chdir(self.folder)
            self.prepare(part)
            for printed, here in self.places.items():
                part = part.replace(printed, here)
            words = shlex.split(part, comments=True)
            program = Path(words[0]).name
            if program == "cd":
                os.chdir(words[1])
            elif program == "peltier":
                self.peltier([one for word in words[1:] for one in (sorted(glob.glob(word)) or [word])])
            elif words[1:3] == ["-m", "pip"]:
                for package in words[4:]:
                    metadata.version(package)  # what a page has one install is what the tests have
            elif program == "lewis":
                self.start([str(Path(sys.executable).parent / "lewis"), *words[1:]])
                self.wait_for_port(int(self.places["5024"]))
            elif program == "sqlite3" and shutil.which("sqlite3") is None:
                import sqlite3

                with sqlite3.connect(f"file:{words[2]}?mode=ro", uri=True) as history:
                    history.execute(words[3]).fetchall()
            else:
                subprocess.run(["bash", "-ec", part], check=True, capture_output=True, text=True, timeout=60)

    def peltier(self, words: list[str]) -> None:
        if words[0] in LASTING:
            self.start([sys.executable, "-m", "rig", *words])
            self.first_lines(1)
            until_s = time.monotonic() + 20.0
            while words[0] == "serve" and main(["status"]) == 11 and time.monotonic() < until_s:
                time.sleep(0.1)  # nobody types the next line before the controller has answered
            return
        if words == ["replay", "RUN"]:
            words = ["replay", str(self.last_run())]
        self.capsys.readouterr()
        status = main(words)
        captured = self.capsys.readouterr()
        self.printed = " ".join((captured.out + captured.err).split())
        refused = "expected" in captured.err and self.page == "docs/records.md"  # the page shows a refusal
        assert status == (2 if refused else 0), f"{self.page}: peltier {shlex.join(words)}: {captured.err}"
        if words[0] == "init":
            self.rehearse(Path(words[1]))

    def last_run(self) -> Path:
        return max(Path.cwd().rglob("run.json"), key=lambda path: path.stat().st_mtime).parent

    def start(self, words: list[str]) -> None:
        self.lasting.append(
            subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ})
        )
        self.lines: list[str] = []

    def first_lines(self, count: int) -> list[str]:
        """What the last program that goes on has printed first."""
        out = self.lasting[-1].stdout
        assert out is not None
        while len(self.lines) < count:
            line = out.readline()
            assert line, f"{self.page}: {self.lasting[-1].args} ended"
            self.lines.append(line)
        return self.lines[:count]

    def wait_for_port(self, port: int) -> None:
        for _ in range(200):
            with socket.socket() as one:
                if one.connect_ex(("127.0.0.1", port)) == 0:
                    return
            time.sleep(0.05)
        raise AssertionError(f"{self.page}: nobody listens at {port}")

    def python(self, block: Block) -> None:
        text = block.text
        for printed, here in self.places.items():
            text = text.replace(printed, here)
        if "127.0.0.1" in text and not self.lasting:
            self.simulated_rig()
            self.peltier(["serve", "rig.toml"])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # PyMeasure's, of its own instruments
            exec(compile("\n" * block.line + text, self.page, "exec"), self.names)

    def toml(self, text: str) -> None:
        """A part of a configuration, of an overview's, or of a model: its tables are those of a whole one."""
        tables = tomllib.loads(text)
        if "overview" in tables:
            Overview.model_validate(tables)
            return
        if "film" in tables or "plate" in tables or "effects" in tables:
            return  # a part of a model: what it means is in the page's Python
        whole = rig.simulated_rig()
        simulated = whole["bench"]
        sweep = tables.pop("sweep", None)
        if sweep is not None:
            SweepFile.model_validate({"sweep": sweep})
        for key, table in tables.items():
            whole[key] = {**whole.get(key, {}), **table}
        if "bench" in tables:  # of a real rig, in real time
            real = {role: {**table, "port": f"/dev/{role}"} for role, table in simulated.items() if role != "time"}
            both = {role: {**table, **tables["bench"].get(role, {})} for role, table in real.items()}
            whole["bench"] = {"time": "real", **both}
        configuration_of(Path("docs.toml"), "", whole, for_experiment=False)

    def end(self) -> None:
        for one in reversed(self.lasting):
            one.send_signal(signal.SIGINT)
        for one in self.lasting:
            one.communicate(timeout=20)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("page", [page for page in WRITTEN if name(page) not in UNTESTED], ids=name)
def test_a_page_runs_as_printed(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda **more: [])  # nobody's rig is spoken to
    monkeypatch.setattr("rig.report.page.svg_text", lambda figure: "<svg></svg>")  # drawn where they are tested
    bench = Bench(page, tmp_path, capsys)
    try:
        for block in blocks(page):
            run_block(bench, block)
    finally:
        bench.end()
    if name(page) == "README.md":  # the first thing that anybody sees is a film's transition
        assert bench.names["rig"].invert(bench.names["found"], [30e3, 10e3]).reachable.all()


def run_block(bench: Bench, block: Block) -> None:
    if block.saved_as:
        Path(block.saved_as).write_text(block.text.replace("5024", bench.places["5024"]), encoding="utf-8")
    elif block.language == "python":
        bench.python(block)
    elif block.language == "toml" or (not block.language and block.text.startswith("[")):
        bench.toml(block.text)
    elif block.language == "json":
        json.loads(block.text)
    elif any(COMMAND.match(line) for line in block.text.splitlines()):
        for line in block.text.splitlines():
            if COMMAND.match(line) and not NOT_RUN.search(line):
                bench.command(line)
            elif not COMMAND.match(line) and block.text.startswith("$ "):  # what the command prints
                for shown in line.split("..."):
                    words = " ".join(shown.rstrip("or ").split())
                    assert words in bench.printed, f"{bench.page}, line {block.line}: {words!r} is not printed"
    else:
        listed = OTHER.get(bench.page, [])
        assert any(block.text.lstrip().startswith(start) for start in listed), f"{bench.page}, line {block.line}"


INLINE = re.compile(r"`(?:\.{0,2}/)?peltier ([a-z]+)((?: [^`]*)?)`")


@pytest.mark.parametrize("page", WRITTEN, ids=name)
def test_verbs_and_options_in_a_page_are_there(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also those between words: a verb that has another name now, an option that is gone."""
    known: dict[str, str] = {}
    for verb, rest in INLINE.findall(page.read_text(encoding="utf-8")):
        if verb in ("test", "lint", "benchmark", "python"):  # the launcher's
            continue
        assert verb in VERBS
        if verb not in known:
            main([verb, "--help"])
            known[verb] = capsys.readouterr().out
        for option in re.findall(r"(?<!\S)--[a-z][a-z-]*", rest):
            assert option in known[verb], f"peltier {verb} {option}"


def test_a_command_that_fails_would_be_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "page.md"
    bench = Bench(page, tmp_path, capsys)
    text = "peltier predict none.toml none.txt\n"
    with pytest.raises(AssertionError, match=r"docs/page.md: peltier predict none.toml none.txt: none.toml: no such"):
        run_block(bench, Block("", text, 1, ""))
    with pytest.raises(AssertionError, match=r"docs/page.md, line 7"):
        run_block(bench, Block("", "what is this\n", 7, ""))
    run_block(bench, Block("", "peltier predict none.toml none.txt  # not run by the tests: there is none\n", 1, ""))
    assert find_spec("lewis")
