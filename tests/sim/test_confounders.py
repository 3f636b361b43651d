"""Two effects that do nearly as well in each other's place are named as a set; beside relays "nearly" is more."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from sim.diagnosis.judge.verdict import Verdict
from sim.diagnosis.report.confounders import confounders_of
from sim.diagnosis.search.chain import Chain

EVIDENCE = 1800.0


class Search:
    """Of a film: its fits have their names' scores."""

    effects = ("film_lag", "meter_lag")

    def __init__(self, scores: dict[frozenset[str], float]) -> None:
        self._scores = scores

    def fit(self, names: frozenset[str]) -> Any:
        return SimpleNamespace(names=names, score=self._scores[names])

    def quick(self, fit: Any, other: str) -> Any:
        return self.fit(fit.names | {other})

    def score_tests(self, fit: Any, others: Iterable[str]) -> dict[str, list[Any]]:
        return {name: [SimpleNamespace(gain=self._scores[frozenset({name})])] for name in others}


class Searched:
    """A chain in which one lag brings more than the other, beside a film with relays or without."""

    def __init__(self, apart: float, has_relays: bool) -> None:
        none = frozenset[str]()
        self._scores = {none: 0.0, none | {"meter_lag"}: EVIDENCE, none | {"film_lag"}: EVIDENCE - apart}
        self._film = SimpleNamespace(parameters=SimpleNamespace(has_relays=has_relays))
        self.budget, self.facts = SimpleNamespace(in_time=self._all), None

    def _all(self, names: Iterable[str], share: float) -> Iterator[str]:
        return iter(names)

    def score(self, names: frozenset[str]) -> float:
        return self._scores[names]

    def split(self, names: frozenset[str]) -> tuple[frozenset[str], frozenset[str]]:
        return frozenset(), names

    def last(self, upstream: frozenset[str]) -> Search:
        return Search(self._scores)

    def instead(self, names: frozenset[str], name: str, other: str) -> Any:
        return self.last(frozenset()).fit(names - {name} | {other})

    def fits(self, names: frozenset[str]) -> tuple[None, Any]:
        return None, self._film

    def followed(self, names: frozenset[str], fit: Any) -> None:
        assert fit.score == self._scores[names]


@pytest.mark.parametrize(
    ("apart", "has_relays", "told_apart"),
    [(5.0, False, False), (33.0, False, True), (33.0, True, False), (700.0, True, True)],
)
def test_what_is_as_good_in_an_effects_place(apart: float, has_relays: bool, told_apart: bool) -> None:
    judged = Verdict(("meter_lag",), {"meter_lag": EVIDENCE}, None, None, {}, frozenset({"meter_lag"}))
    chain = cast(Chain, Searched(apart, has_relays))
    found = confounders_of(chain, frozenset({"meter_lag"}), judged)
    assert found == {"meter_lag": [] if told_apart else ["film_lag"]}
