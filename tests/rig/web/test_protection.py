"""The door: who is let in, what may be loosened (nothing), what is shown (no secret), and STOP when others crowd it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import socket
import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from rig.config.configuration import Configuration, ConfigurationFile, read_configuration
from rig.config.schema import Table
from rig.config.toml_file import without_secrets
from rig.core.faults import Faults
from rig.daemon.client import Client, Refusal
from rig.daemon.configurations import AT_MOST, FREE, FREE_TABLES, PORTS, WITHIN, admit
from rig.daemon.http_server import MOST_CONNECTIONS
from rig.daemon.latch import CLEAR, LATCH, Entry, write
from rig.history import reading
from rig.history.store import Retention, Store
from rig.web import page_server, serving
from rig.web.app import MOST_WAITING, Busy, HistoryQueries, TooLong
from rig.web.page_server import MOST_LINES, BoundedLog
from rig.web.protection import Names
from tests.rig.daemon.benches import HEADERS, RunningBench, running, until, write_current

pytestmark = pytest.mark.usefixtures("undrawn")
TOKEN, METRICS, HOOK = (
    "a token of more than sixteen letters",
    "metrics: another one than that",
    "http://127.0.0.1:9/xyz",
)
SECRETS = f'token = "{TOKEN}"\nmetrics_token = "{METRICS}"\nwebhook = "{HOOK}"\n'
ODD = "kept #1?a%41"  # a folder's name, of characters that mean something in an address


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningBench]:
    """A bench on the loopback with a token, as behind a proxy; its history holds a job with a name that is no text."""
    folder = tmp_path_factory.mktemp("door")
    serve = (
        f'[serve]\nport = 0\nfolder = "{ODD}"\nidle_period_s = 0.1\nhosts = ["https://bench.lab.example"]\n' + SECRETS
    )
    write_current(folder, '["start 0 A", "hold 0.2 s"]', "short", more=serve)
    (folder / ODD).mkdir()
    store = Store(folder / ODD / "history.sqlite", Retention())
    job = {"id": "old", "queued_s": 1.0, "state": "done", "name": "film \ud800", "folder": None, "ended_s": 2.0}
    store.save_job(job)
    store.close()
    write(folder / ODD / LATCH, Entry(CLEAR, "new", "", 1.0))
    with running(write_current(folder, more=serve), web=True) as bench:
        yield bench


def bearer(token: str) -> dict[str, str]:
    return {**HEADERS, "Authorization": f"Bearer {token}"}


def test_a_token_is_asked_for_on_the_loopback_too(bench: RunningBench) -> None:
    for method, path in (
        ("GET", "/api/state"),
        ("POST", "/api/stop"),
        ("GET", "/runs/x/report.html"),
        ("GET", "/metrics"),
    ):
        assert bench.ask(method, path)[0] == 401, path
        assert bench.ask(method, path, headers=bearer(TOKEN))[0] in (200, 404), path
    assert bench.ask("GET", "/health")[0] == 200
    assert bench.ask("GET", "/metrics", headers=bearer(METRICS))[0] == 200
    assert bench.ask("GET", "/api/state", headers=bearer(METRICS))[0] == 401
    bench.ask("POST", "/api/reset", {"reason": "a test"}, bearer(TOKEN))


def test_no_secret_is_shown_anywhere(bench: RunningBench) -> None:
    job = bench.ask("POST", "/api/jobs", {"configuration": "short"}, bearer(TOKEN))[1]
    ended = until(
        lambda: next(
            (
                j
                for j in bench.ask("GET", "/api/jobs", headers=bearer(TOKEN))[1]
                if j["id"] == job["id"] and j["ended_s"]
            ),
            None,
        )
    )
    assert ended["state"] == "done", ended
    shown = [
        bench.ask_fully(*ask, headers=bearer(TOKEN))[2]
        for ask in (("GET", "/api/state"), ("GET", "/api/configurations"))
    ]
    shown += [
        path.read_text()
        for path in Path(ended["folder"]).glob("*")
        if path.suffix in (".toml", ".json", ".html", ".jsonl")
    ]
    assert len(shown) >= 6
    for text in map(str, shown):
        assert not any(secret in text for secret in (TOKEN, METRICS, HOOK))


@pytest.mark.parametrize(
    "text",
    [
        f'[serve]\nname = "b"  # mine\n{SECRETS}',
        f'serve.token = "{TOKEN}"\nserve.name = "b"\n',
        f'serve = {{name = "b", token = "{TOKEN}", webhook = "{HOOK}"}}\n',
        f'[serve]\n"token" = """\n{TOKEN}"""\nname = "b"\n',
        f'[serve]\nname = "b"\ntoken = "{TOKEN}"\n[limits]\n# token was {TOKEN}\ncurrent_A = 1.0\n',
    ],
)
def test_secrets_are_cut_out_of_any_spelling_and_nothing_else_is(text: str) -> None:
    import tomllib

    cut = without_secrets(text)
    assert not any(secret in cut for secret in (TOKEN, METRICS, HOOK))
    before, after = tomllib.loads(text), tomllib.loads(cut)
    for key in ("token", "metrics_token", "webhook"):
        before["serve"].pop(key, None)
    assert after == before
    assert ("# mine" in cut) == ("# mine" in text)


@pytest.mark.parametrize(
    "line", ['token = "short: sixt"', "token = 5123456", 'webhook = "ftp://my/secret"', 'token = ["se cret"]']
)
def test_a_wrong_secret_is_told_without_it(tmp_path: Path, line: str) -> None:
    with pytest.raises(Faults) as caught:
        read_configuration(write_current(tmp_path, more=f"[serve]\n{line}\n"))
    assert f"serve.{line.partition(' ')[0]}: " in str(caught.value)
    assert not any(part in str(caught.value) for part in ("short", "5123456", "ftp", "se cret"))


def test_names_and_origins() -> None:
    names = Names("127.0.0.1", ["https://Bench.lab.example", "inner.lab"])
    for host in ("127.0.0.1:8765", "localhost", "bench.lab.example", "inner.lab:80", "[::1]:8765"):
        assert names.reach(host), host
    for host in ("evil.example", "192.168.1.5", "", "bench.lab.example.evil"):
        assert not names.reach(host), host
    allowed = [
        ("http://127.0.0.1:8765", "127.0.0.1:8765"),
        ("https://bench.lab.example", "127.0.0.1:8765"),
        ("https://bench.lab.example", "bench.lab.example"),
        ("https://inner.lab", "inner.lab"),
        ("http://inner.lab:8765", "inner.lab:8765"),
    ]
    refused = [
        ("https://127.0.0.1:8765", "127.0.0.1:8765"),
        ("http://bench.lab.example", "bench.lab.example"),
        ("http://127.0.0.1:1", "127.0.0.1:8765"),
        ("https://bench.lab.example:444", "bench.lab.example"),
        ("http://inner.lab", "127.0.0.1:8765"),
        ("null", "127.0.0.1:8765"),
        ("ftp://inner.lab", "inner.lab"),
    ]
    assert [pair for pair in allowed if not names.allow(*pair)] == []
    assert [pair for pair in refused if names.allow(*pair)] == []
    stop = Names("127.0.0.1", [], page_port=8765)
    assert stop.allow("http://127.0.0.1:8765", "127.0.0.1:8766")
    assert not stop.allow("http://127.0.0.1:9999", "127.0.0.1:8766")
    assert not stop.allow("http://evil.example:8765", "127.0.0.1:8766")


def guarding(table: type[Table], place: str) -> Iterator[str]:
    """Every key below a table that a job may not loosen."""
    for key, field in table.model_fields.items():
        inner = next(
            (
                a
                for a in (field.annotation, *getattr(field.annotation, "__args__", ()))
                if isinstance(a, type) and issubclass(a, Table)
            ),
            None,
        )
        path = f"{place}{key}"
        if inner is not None and path not in FREE_TABLES:
            yield from guarding(inner, f"{path}.")
        elif inner is None and path not in FREE:
            yield path


def with_value(file: ConfigurationFile, place: str, value: object) -> ConfigurationFile:
    """The same with another value at a key; no schema is asked."""

    def changed(table: Any, keys: list[str]) -> Any:
        inner = value if len(keys) == 1 else changed(getattr(table, keys[0]), keys[1:])
        return table.model_copy(update={keys[0]: inner})

    return ConfigurationFile(file.path, file.text, changed(file.content, place.split(".")))


def other_than(value: Any, place: str) -> object:
    """A value that guards less, or another one where neither does."""
    if place in WITHIN:
        return value[0] - 1.0, value[1]
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value + 1
    return {"address": 5} if isinstance(value, dict) else "another"


def test_a_job_may_loosen_nothing_that_guards(tmp_path: Path) -> None:
    file = read_configuration(write_current(tmp_path))
    admit(file, file, {})
    places = list(guarding(Configuration, ""))
    assert {*AT_MOST, *WITHIN, *PORTS, "limits.polarity_share", "bench.meter.formula"} <= set(places)
    for place in places:
        value: Any = file.content
        for key in place.split("."):
            value = getattr(value, key)
        with pytest.raises(Faults) as caught:
            admit(with_value(file, place, other_than(value, place)), file, {})
        assert f"{place}: " in str(caught.value)
    for place in AT_MOST:
        admit(with_value(file, place, 1e-4), file, {})
    admit(with_value(file, "limits.temperature_degC", (20.0, 50.0)), file, {})
    admit(with_value(file, "bench.meter", None), file, {})
    admit(with_value(file, "experiment.period_s", 1.0), file, {})


def test_broken_text_stays_outside_and_a_list_that_holds_some_is_readable(bench: RunningBench) -> None:
    text = bench.file.text
    broken = [
        b'{"name": "\\ud800"}',
        b'{"name": "\xff"}',
        b'{"name": "\xed\xa0\x80"}',
        b'{"reason": "\\u0000"}',
        b'{"a": NaN}',
    ]
    for raw in (*broken, b'{"a": 1e999}', b"[" * 100_000, b"9" * 5000, b'{"a": ' + b"9" * 4000 + b"}"):
        assert bench.ask("POST", "/api/reset", headers=bearer(TOKEN), raw=raw)[0] == 400, raw[:40]
    for path in ("/api/jobs/%ff", "/runs/%00/x", "/api/history?from=%ed%a0%80", "/%ff"):
        assert bench.ask("GET", path, headers=bearer(TOKEN))[0] == 400, path
    listed = bench.ask("GET", "/api/jobs", headers=bearer(TOKEN))
    assert listed[0] == 200
    assert "film ?" in [job["name"] for job in listed[1]]
    with Client(bench.socket) as client:
        with pytest.raises(Refusal) as refused:
            client.ask("POST", "/api/jobs", text=text, name="\ud800")
        assert refused.value.status == 400
        assert client.ask("POST", "/api/stop", by="\ud800")["confirmed"]  # a STOP is taken whoever says it
        assert bench.commands.latch is not None
        assert "somebody" in bench.commands.latch.text
        assert client.ask("POST", "/api/reset", reason="a test")["reset"]


def test_one_press_on_two_ways_stops_once(bench: RunningBench) -> None:
    first = bench.ask("POST", "/api/stop", {"press": "one"}, bearer(TOKEN))
    assert first[1]["confirmed"]
    assert bench.ask("POST", "/api/reset", {"reason": "a test"}, bearer(TOKEN))[0] == 200
    assert bench.ask("POST", "/api/stop", {"press": "one"}, bearer(TOKEN)) == first
    assert bench.state()["state"] == "idle"
    assert bench.ask("POST", "/api/stop", {"press": "two"}, bearer(TOKEN))[0] == 200
    assert bench.state()["state"] == "stopped"
    assert bench.ask("POST", "/api/reset", {"reason": "a test"}, bearer(TOKEN))[0] == 200


def test_stop_has_a_listener_of_its_own(bench: RunningBench) -> None:
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    ended = threading.Event()

    def serve() -> None:
        asyncio.run(serving.serve(bench.socket, listener, None, ended.set))

    threading.Thread(target=serve, daemon=True).start()
    page, bench.url = bench.url, f"http://127.0.0.1:{port}/"
    own = {"Origin": "http://127.0.0.1:8765"}
    try:
        status, headers, _ = bench.ask_fully("OPTIONS", "/api/stop", headers=own)
        assert (status, headers["access-control-allow-origin"]) == (204, own["Origin"])
        assert bench.ask("OPTIONS", "/api/stop", headers={"Origin": "http://evil.example"})[0] == 403
        assert bench.ask("POST", "/api/stop")[0] == 401
        assert bench.ask("GET", "/api/state", headers=bearer(TOKEN))[0] == 404
        status, headers, answer = bench.ask_fully("POST", "/api/stop", headers={**bearer(TOKEN), **own})
        assert (status, answer["confirmed"]) == (200, True)
        assert headers["access-control-allow-origin"] == own["Origin"]
    finally:
        bench.url = page
    assert bench.ask("POST", "/api/reset", {"reason": "a test"}, bearer(TOKEN))[0] == 200


def test_half_open_connections_shut_nobody_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "PAGE_CONNECTIONS", 6)
    monkeypatch.setattr(page_server, "WHOLE_REQUEST_S", 1000.0)  # none of them is dropped for its age
    path = write_current(tmp_path, more='[serve]\nport = 0\nfolder = "kept"\nidle_period_s = 0.1\n')
    with running(path, web=True) as bench, contextlib.ExitStack() as stack:
        place = urlsplit(bench.url)
        for _ in range(40):
            half = stack.enter_context(socket.create_connection((str(place.hostname), place.port or 0), timeout=10.0))
            half.sendall(b"GET /api/st")
        assert bench.ask("GET", "/health")[0] == 200
        assert bench.ask("POST", "/api/stop")[1]["confirmed"]


def test_a_request_that_is_never_whole_is_dropped(bench: RunningBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_server, "WHOLE_REQUEST_S", 0.1)
    place = urlsplit(bench.url)
    named = {**HEADERS, "Host": "127.0.0.1", "Content-Length": "9"}
    head = "".join(f"{name}: {value}\r\n" for name, value in named.items())
    for begun in (b"", b"GET /api/state HT", f"POST /api/session HTTP/1.1\r\n{head}\r\n{{".encode()):
        with socket.create_connection((str(place.hostname), place.port or 0), timeout=10.0) as connection:
            connection.sendall(begun)
            with contextlib.suppress(ConnectionResetError):
                while connection.recv(4096):
                    pass


def test_who_is_silent_on_the_control_socket_makes_room(bench: RunningBench) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_CONNECTIONS + 10):
            silent = stack.enter_context(socket.socket(socket.AF_UNIX))
            silent.connect(str(bench.socket))
        with Client(bench.socket) as client:
            assert client.ask("GET", "/api/state")["state"]
    assert bench.ask("GET", "/api/state", headers=bearer(TOKEN))[0] == 200


def test_questions_to_the_history_wait_in_line_and_not_for_ever() -> None:
    async def crowded() -> None:
        commands, go_on = HistoryQueries(deadline_s=math.inf), threading.Event()
        waiting = [asyncio.ensure_future(commands.answer(lambda ends_s: go_on.wait())) for _ in range(MOST_WAITING + 2)]
        await asyncio.sleep(0)
        with pytest.raises(Busy):
            await commands.answer(lambda ends_s: 1)
        go_on.set()
        assert all(await asyncio.gather(*waiting))
        assert await commands.answer(lambda ends_s: 1) == 1
        commands.close()

    async def late() -> None:
        commands = HistoryQueries(deadline_s=-1.0)
        with pytest.raises(TooLong):
            await commands.answer(lambda ends_s: 1)
        commands.close()

    asyncio.run(crowded())
    asyncio.run(late())


def test_a_question_to_the_history_is_given_up_at_its_deadline(tmp_path: Path) -> None:
    store = Store(tmp_path / "h.sqlite", Retention())
    store.add({"time_s": 1e9 + k, "temperature_degC": 25.0} for k in range(30_000))
    store.close()
    with pytest.raises(sqlite3.OperationalError, match="interrupted"):
        reading.span(tmp_path / "h.sqlite", 1e9, 1e9 + 3e4, 100, ends_s=time.monotonic() - 1.0)
    assert len(reading.span(tmp_path / "h.sqlite", 1e9, 1e9 + 3e4, 100)["time_s"]) in (100, 101)


def test_nobody_fills_the_log() -> None:
    now_s = 0.0
    few = BoundedLog(lambda: now_s)
    record = logging.makeLogRecord({"msg": "Invalid HTTP request received.", "levelno": logging.WARNING})
    assert sum(few.filter(record) for _ in range(1000)) == MOST_LINES
    now_s = 61.0
    assert few.filter(record)
    assert record.getMessage().endswith(f"({1000 - MOST_LINES} lines before this one were left out)")
