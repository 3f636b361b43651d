"""The HTTP interface as docs/bench_api.md has it, and what it refuses."""

from __future__ import annotations

import contextlib
import http.client
import json
import random
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.config.configuration import read_configuration
from rig.core.faults import Faults
from rig.daemon.serving import bench_of
from tests.rig.daemon.benches import HEADERS, SERVE, RunningBench, running, until, write_current

pytestmark = pytest.mark.usefixtures("undrawn")
STATE = {
    "time_s", "version", "name", "uptime_s", "state", "output", "output_confirmed", "trip", "job", "queue", "reading",
    "limits", "dead_man_s", "instruments", "ticks", "memory_known", "viewers", "warnings",
}  # fmt: skip
READING = {"time_s", "temperature_degC", "setpoint_degC", "current_A", "resistance_ohm", "target_ohm", "quality"}
JOB = {"id", "name", "kind", "state", "queued_s", "started_s", "ended_s", "reason", "folder", "report", "exit_status"}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningBench]:
    folder = tmp_path_factory.mktemp("bench")
    write_current(folder, '["start 0 A", "hold 0.2 s"]', "short", more=SERVE)
    with running(write_current(folder, more=SERVE), web=True) as bench:
        yield bench


def test_state_has_what_is_promised(bench: RunningBench) -> None:
    status, state = bench.ask("GET", "/api/state")
    assert status == 200
    assert set(state) >= STATE
    assert set(state["reading"]) >= READING
    assert state["limits"] == {"temperature_degC": [10.0, 95.0], "current_A": 4.0}
    assert set(state["ticks"]) == {"done", "missed", "latest_s", "unwatched_s"}


def test_events_begin_with_the_state_and_go_on_with_committed_rows(bench: RunningBench) -> None:
    events = bench.events(4)
    assert events[0][0] == "state"
    assert events[0][1]["viewers"] >= 1
    rows = [data for name, data in events if name == "row"]
    assert rows
    assert {"time_s", "temperature_degC", "resistance_ohm", "current_A"} <= set(rows[0])
    until(lambda: not bench.ask("GET", "/api/state")[1]["viewers"], "the viewer's leaving")


def test_a_job_from_its_start_to_its_report(bench: RunningBench) -> None:
    status, known = bench.ask("GET", "/api/configurations")
    assert status == 200
    assert {"config", "short"} <= {entry["name"] for entry in known}
    assert set(known[0]) == {"name", "kind", "text"}
    status, job = bench.ask("POST", "/api/jobs", {"configuration": "short"})
    assert status == 201
    assert set(job) >= JOB

    def ended() -> dict[str, Any] | None:
        return next((j for j in bench.ask("GET", "/api/jobs")[1] if j["id"] == job["id"] and j["ended_s"]), None)

    done = until(ended, "its end")
    assert (done["state"], done["report"]) == ("done", f"/runs/{job['id']}/report.html")
    status, headers, page = bench.ask_fully("GET", done["report"])
    assert (status, headers["content-type"].partition(";")[0]) == (200, "text/html")
    assert b"<html" in page
    for name in ("../../history.sqlite", "..%2f..%2fhistory.sqlite", "nothing.html", "figures"):
        assert bench.ask("GET", f"/runs/{job['id']}/{name}")[0] == 404
    assert bench.ask("GET", "/runs/nobody/report.html")[0] == 404


def test_history_is_thinned_to_the_points_asked_for(bench: RunningBench) -> None:
    until(lambda: bench.ask("GET", "/api/history")[1]["time_s"], "rows")
    now = bench.commands.label_s()
    _, raw = bench.ask("GET", f"/api/history?from={now - 3600}&to={now + 60}&points=5000")
    assert raw["bucket_s"] == 0
    assert raw["columns"]["temperature_degC"]["mean"] == raw["columns"]["temperature_degC"]["low"]
    _, thin = bench.ask("GET", f"/api/history?from={now - 3600}&to={now + 60}&points=2")
    assert thin["bucket_s"] > 0
    assert len(thin["time_s"]) <= 3
    column = thin["columns"]["temperature_degC"]
    assert column["low"][-1] <= column["mean"][-1] <= column["high"][-1]
    for query in ("from=x", "from=5&to=1", "from=nan", "points=1e9", "points=0", "points=-1", "to=inf"):
        assert bench.ask("GET", f"/api/history?{query}")[0] == 422


def test_an_address_that_there_is_not_is_refused_as_all_is(bench: RunningBench) -> None:
    assert bench.ask("GET", "/api/nope") == (404, {"faults": ["GET /api/nope: Not Found"]})
    status, answer = bench.ask("DELETE", "/api/state")
    assert (status, answer) == (405, {"faults": ["DELETE /api/state: Method Not Allowed"]})


def test_stop_and_reset(bench: RunningBench) -> None:
    assert bench.ask("POST", "/api/reset", {"reason": "nothing is latched"})[0] == 409
    status, answer = bench.ask("POST", "/api/stop")
    assert status == 200
    assert (answer["off"], answer["confirmed"]) == (True, True)
    assert answer["took_s"] >= 0.0
    assert bench.ask("GET", "/api/state")[1]["state"] == "stopped"
    assert bench.ask("POST", "/api/reset", {})[0] == 422
    assert bench.ask("POST", "/api/reset", {"reason": 5})[0] == 422
    assert bench.ask("POST", "/api/reset", {"reason": "all is well"})[0] == 200
    assert bench.ask("GET", "/api/state")[1]["state"] == "idle"


def test_what_is_wrong_with_a_configuration_is_told_a_line_each(bench: RunningBench) -> None:
    text = bench.file.text
    status, answer = bench.ask("POST", "/api/jobs", {"text": text.replace("[limits]", "[limit]"), "name": "mine"})
    assert status == 422
    assert any("limit: unknown key" in line for line in answer["faults"])
    assert all(line.startswith("mine: ") for line in answer["faults"])
    for body in ({}, {"configuration": "../config"}, {"configuration": ["x"]}, {"text": 5}, {"text": "=", "name": "x"}):
        status, answer = bench.ask("POST", "/api/jobs", body)
        assert status == 422, body
        assert answer["faults"]
    assert bench.ask("POST", "/api/jobs", {"path": str(bench.file.path)})[0] == 422  # only from this computer
    assert bench.ask("DELETE", "/api/jobs/nobody")[0] == 404


def test_loop_plane_has_points_and_the_model_of_a_job(bench: RunningBench) -> None:
    until(lambda: bench.ask("GET", "/api/loop")[1]["temperature_degC"], "points")
    model = bench.file.path.parent / "model.toml"
    bench.commands.model, bench.commands.memory_since_s = model, bench.commands.label_s() - 0.5
    until(lambda: bench.ask("GET", "/api/loop")[1].get("memory"), "a row since the memory is known")
    status, found = bench.ask("GET", "/api/loop")
    bench.commands.model = bench.commands.memory_since_s = None
    assert status == 200
    assert len(found["temperature_degC"]) == len(found["resistance_ohm"])
    curves = found["model"]
    assert len(curves["temperature_degC"]) == len(curves["rising_ohm"]) == len(curves["falling_ohm"])
    assert all(r >= f * 0.999 for r, f in zip(curves["rising_ohm"], curves["falling_ohm"], strict=True))
    low, high = found["memory"]["reachable_ohm"]
    assert low < high
    assert found["memory"]["branch"] in ("rising", "falling")


def test_metrics_and_health(bench: RunningBench) -> None:
    status, headers, text = bench.ask_fully("GET", "/metrics")
    assert (status, headers["content-type"].partition(";")[0]) == (200, "text/plain")
    assert b'peltier_state{state="idle"} 1.0' in text
    assert b"peltier_ticks_done_total" in text
    assert bench.ask("GET", "/health") == (200, {"ok": True})
    real = bench.commands.state
    bench.commands.state = lambda: real() | {"cycle_age_s": 60.0}  # type: ignore[method-assign]
    status, answer = bench.ask("GET", "/health")
    bench.commands.state = real  # type: ignore[method-assign]
    assert status == 503
    assert "control cycle" in answer["wrong"][0]


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({}, 403),
        ({"Content-Type": "application/json"}, 403),
        ({**HEADERS, "X-Peltier": "yes"}, 403),
        ({"X-Peltier": "1", "Content-Type": "text/plain"}, 415),
        ({**HEADERS, "Origin": "http://evil.example"}, 403),
        ({**HEADERS, "Origin": "null"}, 403),
        ({**HEADERS, "Origin": "http://127.0.0.1:1"}, 403),
        ({**HEADERS, "Host": "evil.example"}, 403),
        ({**HEADERS, "Host": "127.0.0.1.evil.example"}, 403),
    ],
)
def test_another_site_is_refused(bench: RunningBench, headers: dict[str, str], expected: int) -> None:
    assert bench.ask("POST", "/api/stop", headers=headers)[0] == expected
    assert bench.state()["state"] == "idle"


def test_reading_from_another_site_is_refused_and_ones_own_origin_is_not(bench: RunningBench) -> None:
    assert bench.ask("GET", "/api/state", headers={"Origin": "http://evil.example"})[0] == 403
    assert bench.ask("GET", "/api/state", headers={"Host": "evil.example"})[0] == 403
    assert bench.ask("GET", "/", headers={"Host": "evil.example"})[0] == 403
    port = urlsplit(bench.url).port
    for name in ("127.0.0.1", "localhost"):
        origin = f"http://{name}:{port}"
        assert bench.ask("GET", "/api/state", headers={"Host": f"{name}:{port}", "Origin": origin})[0] == 200


def test_a_large_body_is_refused(bench: RunningBench) -> None:
    assert bench.ask("POST", "/api/jobs", raw=b"x" * 1_000_001)[0] == 413
    connection = http.client.HTTPConnection(urlsplit(bench.url).netloc, timeout=10.0)
    body = (b"y" * 100_000 for _ in range(11))
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        connection.request("POST", "/api/jobs", body, HEADERS, encode_chunked=True)
        assert connection.getresponse().status == 413
    connection.close()
    assert bench.ask("GET", "/health")[0] == 200


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    path=st.sampled_from(["/api/jobs", "/api/reset", "/api/session"]),
    body=st.one_of(
        st.binary(max_size=200),
        st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=20),
            lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
            max_leaves=8,
        ).map(lambda value: json.dumps(value).encode()),
        st.fixed_dictionaries(
            {}, optional={key: st.text(max_size=30) | st.none() for key in ("configuration", "text", "name", "reason")}
        ).map(lambda value: json.dumps(value).encode()),
    ),
)
def test_fuzzed_bodies_get_an_answer_that_says_no(bench: RunningBench, path: str, body: bytes) -> None:
    status, _ = bench.ask("POST", path, raw=body)
    assert 400 <= status < 500
    assert bench.state()["state"] == "idle"


def test_fuzzed_bytes_on_both_sockets_kill_nothing(bench: RunningBench) -> None:
    chance = random.Random(5)
    place = urlsplit(bench.url)
    for k in range(60):
        noise = chance.randbytes(chance.randrange(1, 300))
        text = noise if k % 3 else b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\n" + noise + b"\r\n\r\n"
        with socket.create_connection((str(place.hostname), place.port or 0), timeout=5.0) as connection:
            connection.sendall(text)
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(bench.socket))
            connection.sendall(noise if k % 2 else b"GET /" + noise + b" HTTP/1.1\r\n\r\n")
    assert bench.ask("GET", "/health")[0] == 200
    assert bench.state()["state"] == "idle"


TOKEN = "a token of more than sixteen letters"


@pytest.fixture(scope="module")
def open_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningBench]:
    """A bench on every address of this computer, with a token."""
    more = SERVE + f'address = "0.0.0.0"\ntoken = "{TOKEN}"\nhosts = ["bench.lab"]\n'
    with running(write_current(tmp_path_factory.mktemp("open"), more=more), web=True) as bench:
        bench.url = bench.url.replace("0.0.0.0", "127.0.0.1")
        yield bench


def test_beyond_the_loopback_everything_needs_the_token(open_bench: RunningBench) -> None:
    assert open_bench.ask("GET", "/health")[0] == 200
    for wrong in ("", "Bearer", "Bearer ", f"Bearer {TOKEN[:-1]}", f"Bearer {TOKEN}x", f"Basic {TOKEN}", "Bearer \xff"):
        for method, path in (("GET", "/api/state"), ("GET", "/metrics"), ("GET", "/api/events"), ("POST", "/api/stop")):
            assert open_bench.ask(method, path, headers={**HEADERS, "Authorization": wrong})[0] == 401
    right = {**HEADERS, "Authorization": f"Bearer {TOKEN}"}
    assert open_bench.ask("GET", "/api/state", headers=right)[0] == 200
    assert open_bench.ask("GET", "/api/state", headers={**right, "Host": "bench.lab:8765"})[0] == 200
    assert open_bench.ask("GET", "/api/state", headers={**right, "Host": "192.168.1.5:8765"})[0] == 200
    for host in ("evil.example", "192.168.1.5.evil.example", "", "192.168.1"):
        assert open_bench.ask("GET", "/api/state", headers={**right, "Host": host})[0] == 403
    assert open_bench.state()["state"] == "idle"


def test_a_session_stands_for_the_token(open_bench: RunningBench) -> None:
    for body in ({"token": TOKEN[:-1]}, {"token": 5}, {}):
        assert open_bench.ask("POST", "/api/session", body)[0] == 401
    status, headers, _ = open_bench.ask_fully("POST", "/api/session", {"token": TOKEN})
    cookie = headers["set-cookie"]
    assert status == 200
    assert TOKEN not in cookie
    assert "httponly" in cookie.lower()
    assert "samesite=strict" in cookie.lower()
    assert open_bench.ask("GET", "/api/state", headers={"Cookie": cookie.partition(";")[0]})[0] == 200
    assert open_bench.ask("GET", "/api/state", headers={"Cookie": "peltier_session=guessed"})[0] == 401


def test_an_open_address_without_a_token_is_a_fault(tmp_path: Path) -> None:
    file = read_configuration(write_current(tmp_path, more=SERVE))
    with pytest.raises(Faults, match=r"serve\.token: missing"):
        bench_of(file, address="0.0.0.0")
