"""What further records of a film decide of effects that one record leaves open."""

from __future__ import annotations

import pytest

from sim.diagnosis.judge.film_records import Left, decided, evidence

NOISE_DEC = 0.002
WITHOUT = Left(frozenset(), 25.0, (5.0 * NOISE_DEC) ** 2, 40.0)  # five times the noise
NEEDED = 8.0  # of log-likelihood


def left(*names: str, times_the_noise: float, independent: float = 60.0) -> Left:
    return Left(frozenset(names), times_the_noise**2, (times_the_noise * NOISE_DEC) ** 2, independent)


def nothing(names: frozenset[str]) -> Left | None:
    """No film of the run alone."""
    return None


def test_the_effect_with_which_one_film_tells_all_is_said() -> None:
    drift, creep = left("film_drift", times_the_noise=1.5), left("creep", times_the_noise=16.0)
    assert decided(WITHOUT, [creep, drift], NEEDED, nothing) is drift


def test_of_two_that_do_as_well_none_is_said() -> None:
    drift, creep = left("film_drift", times_the_noise=1.5), left("creep", times_the_noise=1.6)
    assert decided(WITHOUT, [creep, drift], NEEDED, nothing) is None


def test_fewer_effects_are_said_where_more_do_no_better() -> None:
    drift, both = left("film_drift", times_the_noise=1.5), left("film_drift", "creep", times_the_noise=1.4)
    assert decided(WITHOUT, [both, drift], NEEDED, nothing) is drift


def test_an_effect_that_leaves_much_is_not_said() -> None:
    assert decided(WITHOUT, [left("film_drift", times_the_noise=3.0)], NEEDED, nothing) is None


def test_few_independent_rows_decide_nothing() -> None:
    drift = left("film_drift", times_the_noise=1.5, independent=5.0)
    assert evidence(WITHOUT, drift) == pytest.approx(0.5 * 5.0 * 2.0 * 1.2040, rel=1e-3)  # ln(5 / 1.5)
    assert decided(WITHOUT, [drift], NEEDED, nothing) is None


def test_nothing_is_said_where_no_film_was_found() -> None:
    assert decided(WITHOUT, [], NEEDED, nothing) is None


def test_beside_a_film_that_is_not_of_the_class_the_records_have_to_agree() -> None:
    """What such a film leaves without any effect is left with the right one, too."""
    heat = left("self_heating", times_the_noise=1.57, independent=450.0)
    before = Left(frozenset(), 1.95**2, (1.95 * NOISE_DEC) ** 2, 450.0)
    assert evidence(before, heat) > 40.0
    own = {"as well": 1.55, "better": 1.3}
    said = {
        how: decided(before, [heat], NEEDED, lambda names, at=at: left(*names, times_the_noise=at))
        for how, at in own.items()
    }
    assert said == {"as well": heat, "better": None}
    few = left("self_heating", times_the_noise=1.57, independent=100.0)
    assert decided(before, [few], NEEDED, lambda names: left(*names, times_the_noise=1.55)) is None
