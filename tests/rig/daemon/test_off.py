"""`peltier off CONFIG` with simulated ports: it means the daemon of that file, whatever else is simulated."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.daemon.benches import SERVE, running, write_current

Peltier = Callable[..., tuple[int, str, str]]


def test_a_simulated_bench_of_another_file_is_left_alone(
    peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = write_current(tmp_path, more=SERVE)
    other = tmp_path / "other.toml"
    other.write_text(mine.read_text())
    link = tmp_path / "link.toml"
    link.symlink_to(mine)
    monkeypatch.setenv("PELTIER_SOCKET", str(tmp_path / "bench.sock"))
    with running(mine) as bench:
        status, out, err = peltier("off", other, "--json", "-")
        assert (status, json.loads(out)["confirmed"]) == (0, True)
        assert f"no daemon serves {other}: nothing is on; left alone: bench" in err
        assert bench.state()["state"] == "idle"
        status, out, err = peltier("off", link)
        assert (status, err) == (0, "")
        assert "bench: output off, confirmed" in out
        bench.until_state("stopped")
    status, out, err = peltier("off", mine)
    assert (status, err) == (0, "")
    assert "nothing is on" in out
    assert "left alone" not in out


@pytest.mark.parametrize("error", [RuntimeError("a driver's own"), ImportError("no serial"), OSError("no room")])
def test_whatever_stands_in_its_way_the_output_is_not_confirmed_off(
    peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """Whoever types `off` must not have to read a traceback to learn that the heater is still on."""

    def fails(config: Path) -> None:
        raise error

    monkeypatch.setenv("PELTIER_SOCKET", str(tmp_path / "bench.sock"))
    monkeypatch.setattr("rig.command.bench._controller", fails)
    status, out, err = peltier("off", "rig.toml")
    assert (status, out, err.count("\n")) == (11, "", 1)
    assert f"OUTPUT NOT CONFIRMED OFF: {'the installation is not whole ' * isinstance(error, ImportError)}" in err
    assert f"{error}" in err
    assert "Switch the controller off by hand." in err
