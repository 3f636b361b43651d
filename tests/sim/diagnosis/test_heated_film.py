"""A film that its ohmmeter heats by kelvins on a steep flank: what heats it hangs on how warm it is."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from tests.sim.diagnosis.said import names

ROWS, PARTS, THETA_K_PER_W, NOISE_K, NOISE_DEC = 2400, 40, 2500.0, 0.005, 1e-3
HALF_WIDTHS_K = np.linspace(0.3, 4.0, 25)
FOLLOWS_S = 0.05  # the film its own heat; much less than a row
FINE_BELOW_OHM, COARSE_ABOVE_OHM = 900.0, 1100.0  # where the ohmmeter changes its range, and its current with it


def record() -> dict[str, np.ndarray]:
    """A row a second: the plate goes up and down at 0.2 K/s between ever other ends; 1 mA at low resistance, else 0.1
    mA. There the film is 2.5 K warmer at most, on a flank of 0.4 decades/K: as the resistance falls, so does the
    heat, by more than the film would have to cool for it."""
    chance = np.random.default_rng(3)
    ends = np.where(np.arange(40) % 2 == 0, chance.uniform(60.0, 70.0, 40), chance.uniform(46.0, 56.0, 40))
    turns_s = np.concatenate(([0.0], np.cumsum(np.ceil(np.abs(np.diff(ends, prepend=45.0)) / 0.2))))  # at rows
    plate = np.interp(np.arange(ROWS * PARTS) / PARTS, turns_s, np.append(45.0, ends))
    plays, warmer, current = np.full(HALF_WIDTHS_K.size, 40.0), 0.0, 1e-4
    ohm = 3e4
    shown, used = np.empty(ROWS), np.empty(ROWS)
    for k in range(ROWS):
        current = 1e-3 if ohm < FINE_BELOW_OHM else 1e-4 if ohm > COARSE_ABOVE_OHM else current
        for degC in plate[max(k - 1, 0) * PARTS + 1 : k * PARTS + 1]:  # up to the row
            warmer += (THETA_K_PER_W * current**2 * ohm - warmer) * -np.expm1(-1.0 / (PARTS * FOLLOWS_S))
            plays = np.clip(plays, degC + warmer - HALF_WIDTHS_K, degC + warmer + HALF_WIDTHS_K)
            ohm = 10.0 ** (3.6 - 1.3 * np.mean(np.tanh((plays - 58.0) / 2.2)) - 3e-3 * (degC + warmer))
        shown[k], used[k] = ohm, current
    return {
        "time_s": np.arange(float(ROWS)),
        "temperature_degC": plate[::PARTS] + NOISE_K * chance.standard_normal(ROWS),
        "resistance_ohm": shown * 10.0 ** (NOISE_DEC * chance.standard_normal(ROWS)),
        "meter_current_A": used,
    }


@pytest.mark.long
@pytest.mark.xfail(strict=True, reason="the film is fitted with the first fit's heat: something is left over")
def test_its_heat_is_found_and_nothing_is_left() -> None:
    found = diagnose(record()).document()
    assert (found["verdict"], names(found)) == ("explained", {"self_heating"})
    assert found["effects"][0]["parameters"]["theta_K_per_W"]["value"] == pytest.approx(THETA_K_PER_W, rel=0.02)
    assert found["channels"]["resistance_dec"]["rmse_extended"] < 2.0 * NOISE_DEC
