"""The transition's numbers for people and for programs: lines, rows of a table, JSON."""

from __future__ import annotations

import math
from typing import Any

from sim.inference.quantity import Quantity
from sim.inference.transition.forc import Forc
from sim.inference.transition.transition import Transition

WORDS = {
    "heating_degC": ("transition temperature on heating", "degC"),
    "cooling_degC": ("transition temperature on cooling", "degC"),
    "hysteresis_K": ("hysteresis, the difference of both", "K"),
    "width_heating_K": ("width on heating, FWHM", "K"),
    "width_cooling_K": ("width on cooling, FWHM", "K"),
    "midpoint_heating_degC": ("midpoint on heating", "degC"),
    "midpoint_cooling_degC": ("midpoint on cooling", "degC"),
    "hysteresis_at_midpoint_K": ("hysteresis at the midpoints", "K"),
    "change_dec": ("fall of log10 R, cold to hot", "decades"),
    "change": ("change of the output, cold to hot", ""),
    "activation_energy_eV": ("activation energy, insulating side", "eV"),
}


def number(quantity: Quantity, unit: str) -> str:
    """A value and half of its interval, both to the interval's second digit."""
    if quantity.value is None or quantity.ci95 is None:
        return f"not determined: {quantity.reason}"
    half = 0.5 * (quantity.ci95[1] - quantity.ci95[0])
    digits = max(0, 1 - math.floor(math.log10(half))) if half > 0.0 else 6
    return f"{quantity.value:.{digits}f} +- {half:.{digits}f} {unit}".rstrip()


def rows(found: Transition, unit: str = "") -> list[tuple[str, str]]:
    """(what, number) of everything; unit: of an output that is no resistance."""
    named = {name: WORDS[name] for name in WORDS if name in found.quantities}
    if not found.in_decades:
        named.pop("activation_energy_eV", None)
    return [(what, number(found.quantities[name], of or unit)) for name, (what, of) in named.items()]


def lines(found: Transition, forc: Forc, unit: str = "", lag_s: float | None = None, timed: bool = True) -> list[str]:
    """What the terminal shows. Of reversal curves only where there is a diagram: a record that was not made for one has
    too few of them, and the page and the JSON say so."""
    told = [f"  {what:<36}{value}" for what, value in rows(found, unit)]
    of_curves = [] if forc.reason else [forc_note(forc)]
    return [
        "transition, with 95 % intervals:",
        *told,
        *(f"  {note}" for note in [*notes(found, lag_s, timed), *of_curves]),
    ]


def definition(found: Transition) -> str:
    """What the numbers are, with the windows that they were taken over."""
    what = "log10 R" if found.in_decades else "output"
    windows = ", ".join(f"{sense} {2.0 * shape.window_K:.1f} K" for sense, shape in found.shapes.items())
    text = f"transition temperature: where |d {what} / dT| of the major branch is largest, over a window of {windows}"
    low, high = found.range_degC
    return f"{text}; midpoint: where {what} is halfway between {low:.1f} and {high:.1f} degC" if found.shapes else ""


def notes(found: Transition, lag_s: float | None = None, timed: bool = True) -> list[str]:
    """What to know of the numbers. lag_s: of the thermometer behind the plate, taken out of the temperatures, where it
    is known. timed: whether the record has times: else there are no rates."""
    said = [definition(found)] if found.shapes else []
    if found.activation is not None and found.activation.energy_eV.value is not None:
        low, high = found.activation.low_degC, found.activation.high_degC
        said.append(f"activation energy: of ln R over 1/(kT) between {low:.1f} and {high:.1f} degC")
    rates = found.rates_K_per_s() if timed else {}
    if rates:
        ramps = " and ".join(f"{rate:.2g} K/s on {sense}" for sense, rate in rates.items())
        text = f"ramps: {ramps}; each second that the thermometer lags behind the film makes the loop look "
        text += f"{found.shift_K(1.0):.2g} K narrower, each that the film lags behind it as much wider; "
        text += "no interval holds that"
        if lag_s is not None and lag_s > 0.0:
            text += f"; its lag behind the plate of {lag_s:.2g} s ({found.shift_K(lag_s):.2g} K) is taken out"
        said.append(text)
    return said


def forc_note(forc: Forc) -> str:
    """What became of the reversal curves."""
    if forc.reason:
        return f"FORC diagram: not drawn: {forc.reason}"
    peak = forc.peak()
    text = f"FORC diagram: of {forc.reversal_degC.size} curves of {forc.sense}"
    if peak is None:
        return text + ", too far apart for any window"
    return f"{text}; largest at T_r {peak[0]:.1f} degC, T {peak[1]:.1f} degC"


def document(
    source: str, found: Transition, forc: Forc, lag_s: float | None = None, timed: bool = True
) -> dict[str, Any]:
    """One record's entry under "transition" in the JSON."""
    peak = forc.peak()
    return {
        "record": source,
        **{name: quantity.table() for name, quantity in found.quantities.items()},
        "definition": definition(found),
        "window_K": {sense: 2.0 * shape.window_K for sense, shape in found.shapes.items()},
        "rate_K_per_s": found.rates_K_per_s() if timed else None,
        "sensor_lag": None if lag_s is None else {"tau_s": lag_s, "shift_K": found.shift_K(lag_s), "taken_out": True},
        "range_degC": list(found.range_degC) if found.shapes else None,
        "activation_range_degC": (
            [found.activation.low_degC, found.activation.high_degC]
            if found.activation is not None and found.activation.energy_eV.value is not None
            else None
        ),
        "forc": {
            "curves": int(forc.reversal_degC.size),
            "sense": forc.sense,
            "reason": forc.reason or None,
            "window_K": list(forc.window_K) if not forc.reason else None,
            "peak": None if peak is None else dict(zip(("reversal_degC", "degC", "density_per_K2"), peak, strict=True)),
        },
    }
