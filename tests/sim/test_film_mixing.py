"""How the phases of a film mix: power means and effective media, back and forth, and straight beyond the ends."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from compensator.hysteresis.functions import Array
from sim.model.film_mixing import PhaseMixing

LOW_DEC, HIGH_DEC = -5.0, -2.5
INSULATOR_S, METAL_S = 10.0**-5.0, 10.0**-2.5
SHARE = np.linspace(0.0, 1.0, 21)
U = LOW_DEC + SHARE * (HIGH_DEC - LOW_DEC)
PHASES = [(-0.8, 0.0), (0.6, 0.0), (0.2, 1.2), (0.0, 0.0), (-1.5, 2.25), (0.0, 1.0), (1e-3, 0.0), (0.0, 1e-6)]


@pytest.mark.parametrize("exponent", [-1.0, -0.3, 0.4, 1.0])
def test_the_output_is_the_power_mean_of_both_ends(exponent: float) -> None:
    ohm = ((1.0 - SHARE) * INSULATOR_S**-exponent + SHARE * METAL_S**-exponent) ** (1.0 / exponent)
    phases = PhaseMixing(LOW_DEC, HIGH_DEC, exponent, 0.0)
    np.testing.assert_allclose(phases.mixed(U), -np.log10(ohm), atol=1e-9)
    np.testing.assert_allclose(phases.unmixed(-np.log10(ohm)), U, atol=1e-9)
    read = phases.reading()
    np.testing.assert_allclose(read.effect.form.read(read.par, 10.0**-U), ohm, rtol=1e-9)  # type: ignore[union-attr]


def medium(threshold: float, critical_exponent: float) -> Array:
    """-log10 of resistance of D. McLachlan's general effective medium at each share, from its own equation."""
    a, t = (1.0 - threshold) / threshold, 1.0 / critical_exponent

    def off(log10_s: float, share: float) -> float:
        s, metal, insulator = 10.0 ** (t * log10_s), METAL_S**t, INSULATOR_S**t
        return share * (metal - s) / (metal + a * s) + (1.0 - share) * (insulator - s) / (insulator + a * s)

    return np.array([brentq(off, -5.1, -2.4, args=(share,), xtol=1e-13) for share in SHARE])


@pytest.mark.parametrize(("dimensions", "critical_exponent"), [(2.0, 1.0), (3.0, 1.0), (2.0, 1.3), (3.0, 2.0)])
def test_the_output_is_that_of_an_effective_medium(dimensions: float, critical_exponent: float) -> None:
    q = 1.0 / critical_exponent
    exponent = q * (2.0 / dimensions - 1.0)
    phases = PhaseMixing(LOW_DEC, HIGH_DEC, exponent, q**2 - exponent**2)
    expected = medium(1.0 / dimensions, critical_exponent)
    np.testing.assert_allclose(phases.mixed(U), expected, atol=1e-9)
    np.testing.assert_allclose(phases.unmixed(expected), U, atol=1e-9)
    assert np.max(np.abs(U - expected)) > 0.2  # what logarithms would be off by


def test_logarithms_add_where_both_numbers_are_0() -> None:
    u = np.linspace(-6.0, -2.0, 9)
    np.testing.assert_array_equal(PhaseMixing(LOW_DEC, HIGH_DEC, 0.0, 0.0).mixed(u), u)
    np.testing.assert_allclose(PhaseMixing(LOW_DEC, HIGH_DEC, 1e-5, 0.0).mixed(u), u, atol=1e-4)
    np.testing.assert_allclose(PhaseMixing(LOW_DEC, HIGH_DEC, 0.0, 1e-10).mixed(u), u, atol=1e-8)


@pytest.mark.parametrize(("exponent", "percolation"), PHASES)
def test_beyond_the_ends_it_goes_on_straight(exponent: float, percolation: float) -> None:
    phases = PhaseMixing(LOW_DEC, HIGH_DEC, exponent, percolation)
    for end, out in ((LOW_DEC, -1.0), (HIGH_DEC, 1.0)):
        inside, at, beyond, further = phases.mixed(end + out * np.array([-1e-6, 0.0, 1e-6, 2e-6]))
        assert beyond - at == pytest.approx(at - inside, rel=1e-3)
        assert further - beyond == pytest.approx(beyond - at, rel=1e-6)


@pytest.mark.parametrize(("exponent", "percolation"), PHASES)
def test_it_comes_back_and_its_slope_is_its_own(exponent: float, percolation: float) -> None:
    phases = PhaseMixing(LOW_DEC, HIGH_DEC, exponent, percolation)
    u = np.linspace(-5.3, -2.2, 311)
    y = phases.mixed(u)
    assert np.all(np.diff(y) > 0.0)
    np.testing.assert_allclose(phases.unmixed(y), u, atol=1e-9)
    inside = (u > -4.99) & (u < -2.51)
    quotient = (phases.mixed(u + 1e-6) - phases.mixed(u - 1e-6)) / 2e-6
    np.testing.assert_allclose(phases.slope(y)[inside], quotient[inside], rtol=1e-4)
