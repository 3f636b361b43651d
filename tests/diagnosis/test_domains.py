"""Films whose domains switch one by one: their steps are their own, and effects are found beside them."""

from __future__ import annotations

import pytest

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.fit.domain_noise import domain_noise, steps_may_show
from sim.diagnosis.fit.repeated_passes import repeated
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.judge.domains import DEVIATIONS, SHARE
from sim.diagnosis.search.chain import Chain, temperature_search
from sim.diagnosis.search.film_facts import LEAST_NOISE_DEC
from sim.diagnosis.search.learned import with_domains, with_film
from sim.diagnosis.validate.adequacies import adequacies
from sim.effects.catalogue import catalogue
from tests.diagnosis.cases import Case, case
from tests.diagnosis.said import covered, names

NOTHING = frozenset[str]()  # no effect


def without_domains(blind: Case) -> tuple[Chain, ResistanceChannel, ResistanceFit]:
    """The record with a smooth film and no effect: the chain, the ohmmeter's channel, and its fit."""
    first = temperature_search(read_columns(blind.columns, held_out=True), catalogue())
    smooth = with_film(Chain(first.channel.record, catalogue(), first), NOTHING)
    fit = smooth.fits(NOTHING)[1]
    assert fit is not None
    return smooth, smooth.film_channel(NOTHING), fit


def test_steps_are_told_from_the_ohmmeters_noise() -> None:
    blind = case("domains", 4)
    smooth, channel, fit = without_domains(blind)
    assert steps_may_show(channel, fit, 20.0)
    chain = with_domains(smooth, NOTHING)
    facts, left = chain.facts, adequacies(chain, NOTHING)[1]
    assert facts is not None
    assert facts.domains is not None
    assert left is not None
    assert left.clean
    assert facts.noise.level == pytest.approx(blind.noise["resistance_dec"], rel=0.1)
    assert blind.details["domains"] == 1235  # each of about 0.0025 decades, of which relays follow a part
    assert 0.0005 < facts.domains.step_dec < 0.005


def test_twenty_four_domains_come_again() -> None:
    """In rows of a second, 0.2 K apart, with jumps of up to a decade: told as 0.27 alike, where 0.3 is needed."""
    blind = case("domains", 326, count=24, smooth="mixed", manner="rows_of_1_s", rows=2000)
    _, channel, fit = without_domains(blind)
    found = repeated(channel, fit, domain_noise(channel, fit, LEAST_NOISE_DEC))
    assert min(one.share for one in found) > SHARE
    assert min(one.deviations for one in found) > DEVIATIONS


@pytest.mark.long
def test_a_lag_beside_steps_is_found() -> None:
    blind = case("domains", 1, count=600, rows=2000, effect="film_lag")
    found = diagnose(blind.columns)
    document = found.document()
    assert names(document) == {"film_lag"}
    assert document["verdict"] == "explained"
    covered(document, blind)
    assert found.channels["resistance_dec"].noise == pytest.approx(blind.noise["resistance_dec"], rel=0.2)
    assert [w["code"] for w in document["warnings"]].count("film_in_steps") == 1
    assert document["film"]["domains"]["step_dec"] > 0.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 6])
def test_a_film_in_steps_is_clean(seed: int) -> None:
    assert diagnose(case("domains", seed).columns).document()["verdict"] == "clean"


@pytest.mark.long
@pytest.mark.parametrize("fault", ["bad_joint", "loose_contact", "pickup"])
def test_a_fault_beside_steps_is_not_explained_by_them(fault: str) -> None:
    blind = case("domains", 3, count=600, fault=fault)
    document = diagnose(blind.columns).document()
    assert document["verdict"] == "unexplained"


@pytest.mark.long
def test_what_comes_again_in_each_pass_is_no_effect() -> None:
    """An error of a range of 3.5 % at 10 kohm was named, with a log-likelihood of 33, though 2.7 deviations off 0."""
    blind = case("domains", 98004)
    assert blind.hidden == {}
    assert blind.holdout is not None
    document = diagnose(blind.columns, holdout=[blind.holdout]).document()
    assert names(document) == set()
    assert document["verdict"] == "clean"


@pytest.mark.long
def test_a_drift_beside_steps_is_found() -> None:
    blind = case("domains", 5)
    assert set(blind.hidden) == {"film_drift"}
    document = diagnose(blind.columns).document()
    assert names(document) == {"film_drift"}
    covered(document, blind)


@pytest.mark.long
def test_effects_are_not_searched_beside_domains_that_explain_nothing() -> None:
    """Temperature and resistance of two records: what is left comes again 0.2 alike, and was searched for 220 s."""
    blind, said = case("negative", 105004), list[str]()
    assert diagnose(blind.columns, say=said.append).document()["verdict"] == "unexplained"
    assert "a film that switches in steps" in said
    assert said.count("both together") == 1
