"""Units of a record's columns: how each becomes ours, and how labs spell them.

A spelling is taken only where it is plain. 'mohm' and 'MOHM' are written for milliohms and for megohms alike: their
quantity is known, their unit is not, and whoever wrote the file has to say.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np

from compensator.hysteresis.functions import Array

Conversion = Callable[[Array], Array]


def _times(factor: float) -> Conversion:
    return lambda x: x * factor


def _reciprocal(factor: float) -> Conversion:
    """A conductance in units of 1/factor siemens as a resistance; no conductance is a resistance beyond the range."""

    def convert(x: Array) -> Array:
        with np.errstate(divide="ignore"):
            return np.where(x == 0.0, np.inf, factor / x)

    return convert


def _kelvins(factor: float, x: Array) -> Array:
    """A reciprocal temperature in degC; of 0 there is none."""
    with np.errstate(divide="ignore"):
        return np.where(x == 0.0, np.nan, factor / x - 273.15)


def _power(base: float) -> Conversion:
    """A resistance of which the logarithm was written; what no float can hold is beyond the range."""

    def convert(x: Array) -> Array:
        with np.errstate(over="ignore", under="ignore"):
            return np.asarray(base**x, dtype=np.float64)

    return convert


# the ending of our column's name -> unit -> how it becomes ours
UNITS: Mapping[str, Mapping[str, Conversion]] = {
    "s": {
        "s": lambda x: x,
        "ms": _times(1e-3),
        "us": _times(1e-6),
        "ns": _times(1e-9),
        "min": _times(60.0),
        "h": _times(3600.0),
        "d": _times(86400.0),
    },
    "degC": {
        "degC": lambda x: x,
        "K": lambda x: x - 273.15,
        "mK": lambda x: x * 1e-3 - 273.15,
        "degF": lambda x: (x - 32.0) / 1.8,
        "1/K": lambda x: _kelvins(1.0, x),  # as Arrhenius plots have it
        "1000/K": lambda x: _kelvins(1e3, x),
    },
    "ohm": {
        "ohm": lambda x: x,
        "mohm": _times(1e-3),
        "kohm": _times(1e3),
        "Mohm": _times(1e6),
        "Gohm": _times(1e9),
        "log10ohm": _power(10.0),
        "lnohm": _power(float(np.e)),
        "S": _reciprocal(1.0),
        "mS": _reciprocal(1e3),
        "uS": _reciprocal(1e6),
        "nS": _reciprocal(1e9),
    },
    "A": {
        "A": lambda x: x,
        "mA": _times(1e-3),
        "uA": _times(1e-6),
        "nA": _times(1e-9),
        "duty": lambda x: x,
        "percent": lambda x: x / 100.0,
        "pwm255": lambda x: x / 255.0,
    },
}

SHARES = ("duty", "percent", "pwm255")  # of full drive: no amperes
CONDUCTANCES = ("S", "mS", "uS", "nS")
LOGARITHMS = ("log10ohm", "lnohm")
RECIPROCALS = ("1/K", "1000/K")  # of a temperature
SYMBOLS = {"Ω": "ohm", "Ohm": "ohm", "kΩ": "kohm", "kOhm": "kohm", "MΩ": "Mohm", "MOhm": "Mohm", "GΩ": "Gohm"}
SYMBOLS |= {"°C": "degC", "°F": "degF", "μA": "uA", "μS": "uS", "μs": "us", "%": "percent"}
LATEX = {r"\Omega": "Ω", r"\omega": "Ω", r"^\circ": "°", r"^{\circ}": "°", r"\circ": "°", r"\degree": "°", r"\mu": "μ"}
LATEX |= {r"\mathrm": "", r"\rm": "", "$": "", "{": "", "}": "", "\\": ""}

_WORDS = {
    "s": "s sec secs second seconds sek sekunde sekunden seconde secondes segundos secondi 秒",
    "ms": "ms msec msecs millisecond milliseconds millisekunden",
    "us": "us μs usec microsecond microseconds",
    "ns": "ns nsec nanosecond nanoseconds",
    "min": "min mins minute minutes minuten minutos minuti 分",
    "h": "h hr hrs hour hours std stunde stunden heure heures horas ore",
    "d": "d day days tag tage jour jours",
}
_TIMES = {word: unit for unit, words in _WORDS.items() for word in words.split()}
_OHM_PREFIX = {"": "ohm", "m": "mohm", "k": "kohm", "K": "kohm", "kilo": "kohm", "M": "Mohm", "mega": "Mohm"}
_OHM_PREFIX |= {"Mega": "Mohm", "Kilo": "kohm", "meg": "Mohm", "Meg": "Mohm", "G": "Gohm", "milli": "mohm"}
_SIEMENS = {"": "S", "m": "mS", "μ": "uS", "u": "uS", "n": "nS", "milli": "mS", "micro": "uS", "nano": "nS"}
_AMPERE = {"": "A", "m": "mA", "μ": "uA", "u": "uA", "n": "nA", "milli": "mA", "micro": "uA", "nano": "nA"}


# of quantities that no column of ours is: a name that ends in one says so
_OTHER_UNITS = "V mV uV μV kV W mW kW Hz kHz MHz Pa hPa kPa MPa bar mbar Torr nm um μm mm cm counts LSB dB dBm ppm"
OTHER_UNITS = frozenset(_OTHER_UNITS.split())


def straightened(text: str) -> str:
    """One way of writing for what looks the same: signs of unit, full-width letters, LaTeX."""
    text = unicodedata.normalize("NFKC", text)
    if "\\" in text or "$" in text:
        for written, meant in LATEX.items():
            text = text.replace(written, meant)
    return text.replace("º", "°").strip()


def foreign(text: str, ending: str) -> bool:
    """Whether a unit's spelling is one of another quantity than that of our columns with this ending: 'V', 'K/min',
    '1/K', 'Ohm cm'."""
    found = spelled(text)
    if found is not None:
        return found[0] != ending
    text = straightened(text)
    parts = [part for part in re.split(r"[/·*⋅\s]|\^?-\d", text) if part]
    known = [part for part in parts if spelled(part) is not None or part in OTHER_UNITS]
    return text in OTHER_UNITS or (bool(known) and parts != [text])


@lru_cache(maxsize=4096)
def spelled(text: str) -> tuple[str, str | None] | None:
    """What a unit's spelling says: the ending of our column's name, and the unit; None for the unit where the spelling
    leaves it open; None where it is no unit of these."""
    if len(text) > 60:
        return None
    text = re.sub(r"[\s.]", "", straightened(text)).strip("[](){}<>")
    if not text or len(text) > 24:
        return None
    low = text.lower()
    if re.fullmatch(r".*[a-z]dc", low) and low[0] in "av":  # 'Amp DC', 'Volt DC': as meters write into their buffers
        text, low = text[:-2], low[:-2]
    if low in ("mohm", "mohms") and (text.islower() or text.isupper()):
        return "ohm", None
    text = re.sub(r"/(?:sq|square|□)$", "", text)  # a sheet's resistance, ohms per square, is one
    if match := re.fullmatch(r"(.*?)(?:Ω|[Oo]hms?|OHMS?)", text):
        unit = _OHM_PREFIX.get(match[1].rstrip("-"))
        return ("ohm", unit) if unit else None
    if (match := re.fullmatch(r"(.*?)(?:S|[Ss]iemens|mhos?)", text)) and match[1] in _SIEMENS:
        return "ohm", _SIEMENS[match[1]]
    if text in ("1/Ω", "Ω^-1", "Ω-1", "1/Ohm", "1/ohm", "Ohm^-1", "ohm^-1", "A/V"):
        return "ohm", "S"
    if (match := re.fullmatch(r"(.*?)(?:A|[Aa]mps?|[Aa]mperes?)", text)) and match[1] in _AMPERE:
        return "A", _AMPERE[match[1]]
    if low in ("%", "percent", "pct", "prozent"):
        return "A", "percent"
    if text in ("log10ohm", "lg(Ω)", "log10(Ω)", "log10(Ohm)", "log10(ohm)"):
        return "ohm", "log10ohm"
    return _temperature(text) or (("s", _TIMES[low]) if low in _TIMES and text != "MS" else None)


def _temperature(text: str) -> tuple[str, str] | None:
    """Of degrees, the letter alone is a capital: a small c or k is something else."""
    if text == "mK":
        return "degC", "mK"
    match = re.fullmatch(r"(degrees?|deg_?|grad|°|o)?(C|c|celsius|K|k|kelvin|F|f|fahrenheit)", text, re.IGNORECASE)
    if match is None or (match[1] is None and text in "ckf"):
        return None
    return "degC", {"c": "degC", "k": "K", "f": "degF"}[match[2][0].lower()]


def asked_unit(text: str, ending: str) -> str | None:
    """The unit that somebody typed after @, by its name or its symbol; None where it is none of these."""
    unit = SYMBOLS.get(straightened(text), text)
    return unit if unit in UNITS[ending] else None
