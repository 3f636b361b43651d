"""A small set of what benchmarks/wire.py counts: no wrong number, whatever the cable does."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.rig.drivers.faulty_wire import CORRUPTION, DISORDER, REPLY_FAULTS, REQUEST_FAULTS
from tests.rig.drivers.wire_cases import CONTROLLERS, METERS, Case, exchange

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))

import wire


@pytest.mark.parametrize(
    ("case", "kind"),
    [
        pytest.param(case, kind, id=f"{case}, {kind}")
        for case in CONTROLLERS + METERS
        for kind in wire.KINDS
        if kind != "seen" or case.driver in wire.SEEN_BURST  # in the others nothing sees a changed character
    ],
)
def test_no_wrong_number(case: Case, kind: str) -> None:
    kept: dict[str, object] = {}
    tally = wire.wrong_readings(case, kind, 600, kept, lambda: None)
    assert tally.exchanges >= 600
    assert tally.faults > 60
    assert tally.right > 60
    assert tally.wrong == 0


def test_a_count_goes_on_where_it_ended() -> None:
    case = CONTROLLERS[0]
    once: dict[str, object] = {}
    wire.wrong_readings(case, "any", 1500, once, lambda: None)
    twice: dict[str, object] = {}
    wire.wrong_readings(case, "any", 400, twice, lambda: None)
    wire.wrong_readings(case, "any", 1500, twice, lambda: None)
    assert once == twice


def test_the_same_seed_does_the_same() -> None:
    assert exchange(METERS[0], 7, DISORDER, 50) == exchange(METERS[0], 7, DISORDER, 50)


def test_every_fault_is_one_or_the_other() -> None:
    assert set(DISORDER) | set(CORRUPTION) == set(REPLY_FAULTS + REQUEST_FAULTS)
    assert not set(DISORDER) & set(CORRUPTION)


def test_what_the_frames_let_pass_is_as_derived() -> None:
    """One of the changes of three hexadecimal digits is a multiple of the polynomial; of one or two digits, none."""
    assert wire.passing_patterns() == 1
    for driver, burst in (("meerstetter", 1), ("meerstetter", 2), ("te_technology", 1)):
        assert wire.passing_share(driver, burst, 5000) == 0.0
    assert 0.003 < wire.passing_share("te_technology", 2, 20000) < 0.02


def test_what_confirmation_costs() -> None:
    proven_ms, bare_ms = wire.confirmation_ms(METERS[0])
    assert 30.0 < bare_ms < proven_ms < 100.0
