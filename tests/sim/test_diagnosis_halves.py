"""Other records decide and judge, but not with the same rows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.diagnosis.data.record import Record, read_columns
from sim.diagnosis.judge import elsewhere
from sim.diagnosis.judge.verdict import Verdict
from sim.diagnosis.report.warnings import decided_elsewhere
from sim.diagnosis.validate.adequacy import Adequacy, Question
from sim.diagnosis.validate.halves import halves_of

ROWS = 600
SINK, LAG = "heat_sink_warmup", "sensor_lag"


def other(rows: int = ROWS) -> Record:
    time = np.arange(float(rows))
    current = np.where(time < 300.0, 1.0, -1.0)
    degC = 30.0 + 5.0 * np.sin(time / 40.0)
    columns = {"time_s": time, "temperature_degC": degC, "current_A": current, "resistance_ohm": 10.0 ** (degC / 30.0)}
    return read_columns(columns, held_out=False)


def verdict(names: frozenset[str], refused: dict[str, str] | None = None, left: Adequacy | None = None) -> Verdict:
    return Verdict(tuple(sorted(names)), dict.fromkeys(names, 50.0), None, left, refused or {}, names)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Any:
    """borne_out of sink and lag on some records, where the errors of each set of effects are given by half."""

    def ask(
        records: list[Record], errors: dict[frozenset[str], tuple[float, float]], film: Adequacy | None = None
    ) -> elsewhere.BorneOut:
        channel, misfit = ("temperature_K", 5.0) if film is None else ("resistance_dec", 1.0)
        known = halves_of(records, [20.0] * len(records))

        def residuals_on(_: Any, names: frozenset[str], one: Record, __: Any) -> dict[str, NDArray[np.float64]]:
            k = next(k for k, record in enumerate(records) if record is one)
            first, second = errors[names]
            left = np.where(known.first[k], first, np.where(known.second[k], second, np.nan))
            return {channel: left}

        def judge(_: Any, names: frozenset[str], before: Verdict, why: str) -> Verdict:
            return verdict(names, {**before.refused, **dict.fromkeys(before.fitted - names, why)}, before.resistance)

        monkeypatch.setattr(elsewhere, "residuals_on", residuals_on)
        monkeypatch.setattr(elsewhere, "judge", judge)
        monkeypatch.setattr(elsewhere, "_correlated_s", lambda *_: 20.0)
        chain = SimpleNamespace(first=SimpleNamespace(channel=SimpleNamespace(misfit=misfit)), facts=None)
        return elsewhere.borne_out(chain, verdict(frozenset({SINK, LAG}), left=film), records)  # type: ignore[arg-type]

    return ask


BOTH, NEITHER = frozenset({SINK, LAG}), frozenset[str]()
SINK_ALONE, LAG_ALONE = frozenset({SINK}), frozenset({LAG})


def test_a_record_is_divided_into_blocks_as_long_as_it_hangs_together() -> None:
    record = other()
    halves = halves_of([record], [40.0])
    (first,), (second,) = halves.first, halves.second
    assert not np.any(first & second)
    assert not np.any((first | second)[:31])  # to which room and first temperatures are fitted
    assert np.all((first | second)[31:])
    edges = np.flatnonzero(np.diff(first[31:].astype(int)) != 0)
    assert set(np.diff(edges).tolist()) == {40}
    assert [part["half"] for part in halves.document()[:3]] == [1, 2, 1]
    slow = halves_of([record], [1e4])  # three blocks of each half at least
    assert [part["half"] for part in slow.document()] == [1, 2, 1, 2, 1, 2]


def test_of_several_records_every_other_one_is_in_a_half() -> None:
    halves = halves_of([other(), other(), other()], [20.0] * 3)
    assert [bool(np.any(rows)) for rows in halves.first] == [True, False, True]
    assert [bool(np.any(rows)) for rows in halves.second] == [False, True, False]


def test_halves_that_agree_judge_both(asked: Any) -> None:
    told = asked([other()], {BOTH: (1.0, 1.0), SINK_ALONE: (2.0, 2.0), LAG_ALONE: (0.5, 0.5), NEITHER: (3.0, 3.0)})
    assert told.judged.fitted == LAG_ALONE
    assert np.sum(told.halves.judging[0]) == ROWS - 31
    assert len(told.halves.folds) == 2
    assert decided_elsewhere(told.halves) == []


@pytest.mark.parametrize("swapped", [False, True])
def test_the_half_that_takes_a_name_away_does_not_judge(asked: Any, swapped: bool) -> None:
    """The first half is told better without the sink, the second does not mind: what is measured is the second."""
    errors = {BOTH: (1.0, 1.0), SINK_ALONE: (2.0, 2.0), LAG_ALONE: (0.5, 1.2), NEITHER: (3.0, 3.0)}
    if swapped:
        errors = {names: (b, a) for names, (a, b) in errors.items()}
    records = [other()]
    told = asked(records, errors)
    assert told.judged.fitted == LAG_ALONE
    halves = halves_of(records, [20.0] * len(records))
    judging = halves.first[0] if swapped else halves.second[0]
    np.testing.assert_array_equal(told.halves.judging[0], judging)
    assert told.halves.folds == [{"deciding": ROWS - 31 - int(np.sum(judging)), "judging": int(np.sum(judging))}]
    (warning,) = decided_elsewhere(told.halves)
    assert warning.code == "held_out_rows_decided"
    assert f"speak against {SINK}, " in warning.text


def test_halves_that_speak_against_different_names_are_told(asked: Any) -> None:
    told = asked([other()], {BOTH: (1.0, 1.0), SINK_ALONE: (0.5, 2.0), LAG_ALONE: (2.0, 0.5), NEITHER: (3.0, 3.0)})
    assert told.judged.fitted == NEITHER
    assert told.halves.folds == [{"deciding": ROWS - 31, "judging": 0}]
    text = decided_elsewhere(told.halves)[0].text
    assert "optimistic" in text
    assert f"({', '.join(sorted((SINK, LAG)))})" in text


def test_what_one_record_speaks_against_and_all_together_need_is_said(asked: Any) -> None:
    """A sink that one run shows and another one hardly has: without it the first is not predicted at all."""
    errors = {BOTH: (0.5, 1.5), LAG_ALONE: (7.0, 0.5), SINK_ALONE: (3.0, 10.0), NEITHER: (2.0, 13.0)}
    told = asked([other(), other()], errors)
    assert told.judged.fitted == BOTH
    assert [bool(np.any(rows)) for rows in told.halves.judging] == [False, True]
    assert f"speak against {SINK}, which all of them together need" in decided_elsewhere(told.halves)[0].text
    of_one = asked([other()], errors)  # blocks of one record are alike: no cause is in a half of them alone
    assert of_one.judged.fitted == LAG_ALONE
    assert "it is not said" in decided_elsewhere(of_one.halves)[0].text


def test_what_several_records_together_speak_against_is_not_said(asked: Any) -> None:
    errors = {BOTH: (1.0, 3.0), LAG_ALONE: (1.2, 1.0), SINK_ALONE: (3.0, 10.0), NEITHER: (2.0, 13.0)}
    told = asked([other(), other()], errors)
    assert told.judged.fitted == LAG_ALONE
    assert "it is not said" in decided_elsewhere(told.halves)[0].text


SOMETHING = Adequacy((Question("blocks of 12 rows", -50.0, 0.2),), 1.2)
NOTHING = Adequacy((Question("blocks of 12 rows", -0.5, 0.0),), 1.0)


@pytest.mark.parametrize(("grows", "left"), [(1.02, NEITHER), (0.98, SINK_ALONE)])
def test_beside_a_film_that_is_not_understood_a_name_helps(asked: Any, grows: float, left: frozenset[str]) -> None:
    """Two that undo each other: each is needed beside the other one, the two do what none does."""
    errors = {BOTH: (1.02, 1.02), SINK_ALONE: (grows, grows), LAG_ALONE: (2.0, 2.0), NEITHER: (1.0, 1.0)}
    assert asked([other()], errors, SOMETHING).judged.fitted == left
    assert asked([other()], errors, NOTHING).judged.fitted == BOTH


def test_a_plate_s_error_may_grow_by_what_the_first_rows_leave_open_of_a_room(asked: Any) -> None:
    errors = {BOTH: (1.02, 1.02), SINK_ALONE: (1.0, 1.0), LAG_ALONE: (2.0, 2.0), NEITHER: (1.0, 1.0)}
    assert asked([other()], errors).judged.fitted == BOTH


def test_rows_that_are_not_asked_all_judge() -> None:
    assert halves_of([other()], [20.0]).folds == [{"deciding": 0, "judging": ROWS - 31}]
