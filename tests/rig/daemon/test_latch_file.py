"""The latch's file: what it says is what was kept, and whatever is damaged, torn or missing never says "clear"."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.daemon import latch
from rig.daemon.latch import CLEAR, SIZE, STOPPED, TRIPPED, Entry, Unreadable, read, write

NEW = Entry(CLEAR, "new", "nothing was ever latched here", 1.79e9)
TRIP = Entry(TRIPPED, "temperature_limit", "61.6 degC, limit 61.5 degC", 1.79e9 + 0.1)


def file_of(folder: Path, *said: Entry) -> Path:
    path = folder / "bench.latch"
    for kept in said:
        write(path, kept)
    return path


def test_it_says_what_was_kept_last_and_its_space_is_taken(tmp_path: Path) -> None:
    assert read(tmp_path / "bench.latch") is None
    for count in range(1, 6):
        said = [Entry(TRIPPED if k % 2 else CLEAR, f"cause {k}", f"text {k}", float(k)) for k in range(count)]
        path = file_of(tmp_path / str(count), *said)
        assert read(path) == said[-1]
        assert path.stat().st_size == SIZE
        assert 512 * path.stat().st_blocks >= SIZE
        assert [p.name for p in path.parent.iterdir()] == ["bench.latch"]


@settings(max_examples=50, deadline=None)
@given(text=st.text(max_size=6000))
def test_any_text_fits(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = file_of(tmp_path_factory.mktemp("text"), NEW, Entry(STOPPED, "stop", text, 1.0))
    found = read(path)
    assert found is not None
    assert text.startswith(found.text)
    assert found.text == text or len(found.text) > 200
    assert path.stat().st_size == SIZE


@settings(max_examples=300, deadline=None)
@given(at=st.integers(0, SIZE - 1), more=st.integers(1, 255))
def test_a_changed_byte_makes_it_unreadable(tmp_path_factory: pytest.TempPathFactory, at: int, more: int) -> None:
    path = file_of(tmp_path_factory.mktemp("byte"), NEW, TRIP)
    data = bytearray(path.read_bytes())
    data[at] = (data[at] + more) % 256
    path.write_bytes(bytes(data))
    with pytest.raises(Unreadable):
        read(path)


def test_a_write_that_was_cut_short_anywhere_never_falls_back_to_clear(tmp_path: Path) -> None:
    path = file_of(tmp_path, NEW, NEW)
    before = path.read_bytes()
    write(path, TRIP)
    after = path.read_bytes()
    outcomes = set()
    for cut in [*range(0, SIZE, 11), SIZE]:
        path.write_bytes(after[:cut] + before[cut:])
        try:
            found = read(path)
        except Unreadable:
            outcomes.add("unreadable")
            continue
        if found != TRIP:
            assert path.read_bytes() == before  # nothing of the trip had reached the disk, so nobody had been told
        outcomes.add(found.state if found is not None else "none")
    assert outcomes == {"clear", "unreadable", "tripped"}


@pytest.mark.parametrize("damage", ["truncated", "empty", "longer", "zeros", "a sector", "folder", "earlier version"])
def test_what_is_damaged_is_told_and_whole_again_after_the_next_write(tmp_path: Path, damage: str) -> None:
    path = file_of(tmp_path, NEW, TRIP, NEW)
    data = path.read_bytes()
    earlier = b"peltier latch 1 " + data[16:]
    if damage == "folder":
        path.unlink()
        path.mkdir()
    else:
        path.write_bytes(
            {
                "truncated": data[: SIZE // 2],
                "empty": b"",
                "longer": data + b" ",
                "zeros": b"\0" * SIZE,
                "a sector": data[:-512] + b"\xff" * 512,
                "earlier version": earlier,
            }[damage]
        )
    with pytest.raises(Unreadable):
        read(path)
    if damage == "folder":
        path.rmdir()
    write(path, TRIP)
    assert read(path) == TRIP
    write(path, NEW)
    assert read(path) == NEW


def test_a_disk_without_room_leaves_nothing_half_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, begin: int, size: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    path = file_of(tmp_path / "there", NEW)
    monkeypatch.setattr(latch.os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space left"):
        write(tmp_path / "new" / "bench.latch", NEW)
    assert list((tmp_path / "new").iterdir()) == []
    with pytest.raises(OSError, match="No space left"):  # a copy with holes has no room of its own
        write(path, TRIP)
    assert read(path) == NEW
