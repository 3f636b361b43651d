"""Units of a record's columns: how each converts to ours, and how labs spell them.

A spelling is accepted only if it has one meaning. 'mohm' and 'MOHM' stand for milliohms and for megohms alike: the
quantity is known, the unit is not, and the user has to name it.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping
from functools import lru_cache, partial

import numpy as np

from compensator.hysteresis.functions import Array

Conversion = Callable[[Array], Array]


def _multiply(factor: float, x: Array) -> Array:
    return x * factor


def _divide(factor: float, offset: float, at_zero: float, x: Array) -> Array:
    """Return factor / x + offset, and at_zero where x is 0 (no conductance: a resistance beyond the range)."""
    with np.errstate(divide="ignore"):
        return np.where(x == 0.0, at_zero, factor / x + offset)


def _raise_to(base: float, x: Array) -> Array:
    """Return the resistance of which x is the logarithm; infinite if no float can hold it."""
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(base**x, dtype=np.float64)


def _factors(**by_unit: float) -> dict[str, Conversion]:
    return {unit: partial(_multiply, factor) for unit, factor in by_unit.items()}


# the ending of our column's name -> unit -> conversion to ours
UNITS: Mapping[str, Mapping[str, Conversion]] = {
    "s": _factors(s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0, h=3600.0, d=86400.0),
    "degC": {
        "degC": lambda x: x,
        "K": lambda x: x - 273.15,
        "mK": lambda x: x * 1e-3 - 273.15,
        "degF": lambda x: (x - 32.0) / 1.8,
        "1/K": partial(_divide, 1.0, -273.15, np.nan),  # the axis of an Arrhenius plot
        "1000/K": partial(_divide, 1e3, -273.15, np.nan),
    },
    "ohm": {
        **_factors(ohm=1.0, mohm=1e-3, kohm=1e3, Mohm=1e6, Gohm=1e9),
        "log10ohm": partial(_raise_to, 10.0),
        "lnohm": partial(_raise_to, float(np.e)),
        **{unit: partial(_divide, 10.0**k, 0.0, np.inf) for unit, k in {"S": 0, "mS": 3, "uS": 6, "nS": 9}.items()},
    },
    "A": {
        **_factors(A=1.0, mA=1e-3, uA=1e-6, nA=1e-9),
        "duty": lambda x: x,
        "percent": lambda x: x / 100.0,
        "pwm255": lambda x: x / 255.0,
    },
}
DRIVE_SHARES = ("duty", "percent", "pwm255")  # of full drive: not amperes
CONDUCTANCES = ("S", "mS", "uS", "nS")
LOGARITHMS = ("log10ohm", "lnohm")
RECIPROCALS = ("1/K", "1000/K")  # of a temperature

_SYMBOLS = {"Ω": "ohm", "Ohm": "ohm", "kΩ": "kohm", "kOhm": "kohm", "MΩ": "Mohm", "MOhm": "Mohm", "GΩ": "Gohm"}
_SYMBOLS |= {"°C": "degC", "°F": "degF", "μA": "uA", "μS": "uS", "μs": "us", "%": "percent"}
_LATEX = {r"\Omega": "Ω", r"\omega": "Ω", r"^\circ": "°", r"^{\circ}": "°", r"\circ": "°", r"\degree": "°"}
_LATEX |= {r"\mu": "μ", r"\mathrm": "", r"\rm": "", "$": "", "{": "", "}": "", "\\": ""}
_TIME_WORDS = {
    "s": "s sec secs second seconds sek sekunde sekunden seconde secondes segundos secondi 秒",
    "ms": "ms msec msecs millisecond milliseconds millisekunden",
    "us": "us μs usec microsecond microseconds",
    "ns": "ns nsec nanosecond nanoseconds",
    "min": "min mins minute minutes minuten minutos minuti 分",
    "h": "h hr hrs hour hours std stunde stunden heure heures horas ore",
    "d": "d day days tag tage jour jours",
}
_TIMES = {word: unit for unit, words in _TIME_WORDS.items() for word in words.split()}
_OHM_PREFIX = {"": "ohm", "m": "mohm", "k": "kohm", "K": "kohm", "kilo": "kohm", "M": "Mohm", "mega": "Mohm"}
_OHM_PREFIX |= {"Mega": "Mohm", "Kilo": "kohm", "meg": "Mohm", "Meg": "Mohm", "G": "Gohm", "milli": "mohm"}
_SMALL_PREFIX = {"": "", "m": "m", "μ": "u", "u": "u", "n": "n", "milli": "m", "micro": "u", "nano": "n"}
_SIEMENS = ("1/Ω", "Ω^-1", "Ω-1", "1/Ohm", "1/ohm", "Ohm^-1", "ohm^-1", "A/V")
# units of quantities that none of our columns has: a name that ends in one is of that quantity
_OTHER = "V mV uV μV kV W mW kW Hz kHz MHz Pa hPa kPa MPa bar mbar Torr nm um μm mm cm counts LSB dB dBm ppm"
OTHER_UNITS = frozenset(_OTHER.split())


def normalize_text(text: str) -> str:
    """Return a text with one spelling of what looks the same: signs of units, full-width letters, LaTeX."""
    text = unicodedata.normalize("NFKC", text)
    if "\\" in text or "$" in text:
        for written, meant in _LATEX.items():
            text = text.replace(written, meant)
    return text.replace("º", "°").strip()


def is_foreign_unit(text: str, ending: str) -> bool:
    """Return True if a unit is of another quantity than our columns with this ending: 'V', 'K/min', '1/K', 'Ohm cm'."""
    found = parse_unit(text)
    if found is not None:
        return found[0] != ending
    text = normalize_text(text)
    parts = [part for part in re.split(r"[/·*⋅\s]|\^?-\d", text) if part]
    known = any(parse_unit(part) is not None or part in OTHER_UNITS for part in parts)
    return text in OTHER_UNITS or (known and parts != [text])


@lru_cache(maxsize=4096)
def parse_unit(text: str) -> tuple[str, str | None] | None:
    """Return the ending of our column's name and the unit that a spelling stands for, as in ("ohm", "kohm").

    The unit is None if the spelling has several meanings; the result is None if it is no unit of `UNITS`.
    """
    if len(text) > 60:
        return None
    text = re.sub(r"[\s.]", "", normalize_text(text)).strip("[](){}<>")
    if not text or len(text) > 24:
        return None
    if re.fullmatch(r"(?=[av]).*[a-z]dc", text.lower()):  # 'Amp DC', 'Volt DC': meters write so into their buffers
        text = text[:-2]
    low = text.lower()
    if low in ("mohm", "mohms") and (text.islower() or text.isupper()):
        return "ohm", None
    text = re.sub(r"/(?:sq|square|□)$", "", text)  # a sheet resistance, ohms per square, is a resistance
    if match := re.fullmatch(r"(.*?)(?:Ω|[Oo]hms?|OHMS?)", text):
        unit = _OHM_PREFIX.get(match[1].rstrip("-"))
        return ("ohm", unit) if unit else None
    if (match := re.fullmatch(r"(.*?)(?:S|[Ss]iemens|mhos?)", text)) and match[1] in _SMALL_PREFIX:
        return "ohm", f"{_SMALL_PREFIX[match[1]]}S"
    if text in _SIEMENS:
        return "ohm", "S"
    if (match := re.fullmatch(r"(.*?)(?:A|[Aa]mps?|[Aa]mperes?)", text)) and match[1] in _SMALL_PREFIX:
        return "A", f"{_SMALL_PREFIX[match[1]]}A"
    if low in ("%", "percent", "pct", "prozent"):
        return "A", "percent"
    if text in ("log10ohm", "lg(Ω)", "log10(Ω)", "log10(Ohm)", "log10(ohm)"):
        return "ohm", "log10ohm"
    if text == "mK":
        return "degC", "mK"
    match = re.fullmatch(r"(degrees?|deg_?|grad|°|o)?(C|celsius|K|kelvin|F|fahrenheit)", text, re.IGNORECASE)
    if match is not None and (match[1] is not None or text not in "ckf"):  # a small letter alone is something else
        return "degC", {"c": "degC", "k": "K", "f": "degF"}[match[2][0].lower()]
    return ("s", _TIMES[low]) if low in _TIMES and text != "MS" else None


def parse_typed_unit(text: str, ending: str) -> str | None:
    """Return the unit that the user typed after @, by name or symbol; None if it is none of this ending's."""
    unit = _SYMBOLS.get(normalize_text(text), text)
    return unit if unit in UNITS[ending] else None
