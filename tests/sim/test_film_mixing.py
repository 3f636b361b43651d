"""How the phases of a film mix: as a power mean says, back and forth, and straight beyond the ends."""

from __future__ import annotations

import numpy as np
import pytest

from sim.model.film_mixing import FilmMixing

MIXING = FilmMixing(60.0, 40.0, -5.0, -2.5)


@pytest.mark.parametrize("exponent", [-1.0, -0.3, 0.4, 1.0])
def test_the_output_is_the_power_mean_of_both_ends(exponent: float) -> None:
    share = np.linspace(0.0, 1.0, 11)
    insulator, metal = 10.0**5.0, 10.0**2.5
    ohm = ((1.0 - share) * insulator**exponent + share * metal**exponent) ** (1.0 / exponent)
    u = MIXING.low_dec + share * (MIXING.high_dec - MIXING.low_dec)
    np.testing.assert_allclose(MIXING.mean(exponent, 0.0).mixed(u), -np.log10(ohm), atol=1e-9)
    np.testing.assert_allclose(MIXING.mean(exponent, 0.0).unmixed(-np.log10(ohm)), u, atol=1e-4)
    read = MIXING.mean(exponent, 0.0).reading()
    np.testing.assert_allclose(read.effect.form.read(read.par, 10.0**-u), ohm, rtol=1e-9)  # type: ignore[union-attr]


def test_logarithms_add_at_an_exponent_of_0() -> None:
    u = np.linspace(-6.0, -2.0, 9)
    np.testing.assert_array_equal(MIXING.mean(0.0, 0.0).mixed(u), u)
    np.testing.assert_allclose(MIXING.mean(1e-6, 0.0).mixed(u), u, atol=1e-5)


def test_a_plane_of_domains_percolates() -> None:
    """In series as long as few are metal, in parallel when most are: Bruggeman's medium of two dimensions, within 0.15
    of 2.5 decades."""
    share = np.linspace(0.0, 1.0, 21)
    b = (2.0 * share - 1.0) * (10.0**2.5 - 1.0)
    conducts = 0.5 * (b + np.sqrt(b**2 + 4.0 * 10.0**2.5))  # over the insulator
    u = MIXING.low_dec + share * 2.5
    found = MIXING.mean(0.0, -1.1).mixed(u)
    assert np.max(np.abs(found - (MIXING.low_dec + np.log10(conducts)))) < 0.15
    assert np.max(np.abs(u - (MIXING.low_dec + np.log10(conducts)))) > 0.3
    np.testing.assert_allclose(MIXING.mean(0.0, -1.1).unmixed(found), u, atol=1e-4)


@pytest.mark.parametrize(("exponent", "tilt"), [(-0.8, 0.0), (0.6, 0.0), (0.2, -1.2)])
def test_beyond_the_ends_it_goes_on_straight(exponent: float, tilt: float) -> None:
    for end, out in ((MIXING.low_dec, -1.0), (MIXING.high_dec, 1.0)):
        inside, at, beyond, further = MIXING.mean(exponent, tilt).mixed(end + out * np.array([-1e-6, 0.0, 1e-6, 2e-6]))
        assert beyond - at == pytest.approx(at - inside, rel=1e-3)
        assert further - beyond == pytest.approx(beyond - at, rel=1e-6)


def test_the_step_between_the_phases_changes_with_temperature_and_never_turns_round() -> None:
    assert MIXING.step(0.0, np.array([0.0, 200.0])) == pytest.approx([1.0, 1.0])
    assert MIXING.step(-0.4, np.array([20.0, 60.0, 80.0, 300.0])) == pytest.approx([1.4, 1.0, 0.8, 0.6])


@pytest.mark.parametrize(("exponent", "tilt"), [(-0.8, 0.0), (0.6, 0.0), (0.2, -1.2), (0.0, 0.0), (-1.5, 0.3)])
def test_the_inverse_is_exact_inside_and_beyond_the_ends(exponent: float, tilt: float) -> None:
    mean = MIXING.mean(exponent, tilt)
    assert mean.rises
    u = np.linspace(-5.3, -2.2, 311)
    np.testing.assert_allclose(mean.inverse(mean.mixed(u)), u, atol=3e-10)
    np.testing.assert_allclose(mean.mixed(mean.inverse(u)), u, atol=1e-10)


def test_a_mean_that_falls_as_metal_grows_is_told() -> None:
    assert not MIXING.mean(0.0, 2.0).rises
