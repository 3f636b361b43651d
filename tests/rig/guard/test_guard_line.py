"""The pipe to the guard, where nobody reads it: nothing that the loop tells waits for long, or is garbled."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from rig.guard import pipe as guard_line
from rig.guard.pipe import ALIVE, GuardGone, GuardPipe

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the guard needs fork")

READS_AFTER_S = 5.0  # far beyond the second that the last message is waited for


@pytest.fixture
def pipe() -> Iterator[tuple[int, GuardPipe]]:
    reader, writer = os.pipe()
    yield reader, GuardPipe(writer, os.getpid())
    os.close(reader)
    os.close(writer)


def fill(writer: GuardPipe) -> None:
    """Until the pipe takes nothing more: half an hour of a loop at 10 Hz."""
    for _ in range(1 << 16):
        writer.alive()


def seconds(work: Callable[[], None], reader: int) -> float:
    """How long it takes; where it waits for the reader, that reads after some seconds."""
    done = threading.Thread(target=work)
    begin_s = time.monotonic()
    done.start()
    done.join(READS_AFTER_S)
    took_s = time.monotonic() - begin_s
    if done.is_alive():
        os.read(reader, 1 << 20)
        done.join()
    return took_s


def read_all(reader: int) -> list[bytes]:
    os.set_blocking(reader, False)
    found = b""
    try:
        while data := os.read(reader, 1 << 16):
            found += data
    except BlockingIOError:
        pass
    assert found.endswith(b"\n")
    return found.splitlines(keepends=True)


def test_a_guard_that_does_not_read_holds_up_no_loop(pipe: tuple[int, GuardPipe]) -> None:
    reader, writer = pipe
    fill(writer)
    for tell in (writer.busy, writer.idle, writer.let_go):
        assert seconds(tell, reader) < READS_AFTER_S
    assert set(read_all(reader)) == {ALIVE}
    writer.alive()  # what was kept back comes first
    *told, last = read_all(reader)
    assert [json.loads(line)["event"] for line in told] == ["busy", "idle", "let_go"]
    assert last == ALIVE


def test_a_message_in_two_writes_stays_in_one_piece(pipe: tuple[int, GuardPipe]) -> None:
    """One thread begins a run in a folder with a long name, another ticks: the pipe takes the name in parts."""
    reader, writer = pipe
    fill(writer)
    folder = "/".join(["", *["\N{GREEK SMALL LETTER OMEGA}" * 100] * 12])
    telling = threading.Thread(target=writer.records, args=(folder,))
    telling.start()
    found = b""
    until_s = time.monotonic() + 5.0
    while (telling.is_alive() or json.dumps(folder).encode() not in found) and time.monotonic() < until_s:
        found += os.read(reader, 1000)
        writer.alive()
    telling.join(5.0)
    whole = [line for line in found.split(b"\n")[:-1] if line != b"."]
    assert [json.loads(line) for line in whole] == [{"event": "records", "folder": folder}]


def test_a_guard_that_reads_nothing_is_gone(pipe: tuple[int, GuardPipe], monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = pipe
    fill(writer)
    monkeypatch.setattr(guard_line, "DEAF_S", 0.2)
    time.sleep(0.3)
    with pytest.raises(GuardGone, match=r"has read nothing for 0.2 s"):
        writer.alive()
    read_all(reader)
    writer.alive()
