"""A port at which nobody answers, in words: which port, what was asked, what to look at."""

from __future__ import annotations

from typing import Any

FALLEN_SILENT_S = 1.0  # several questions in a row: one that is lost is asked again within a tenth of it


def nobody_answers(instrument: Any, port: str, role: str, driver: str, asked: str) -> str | None:
    """The line for it; None where anything at all was heard, or where an instrument's own driver has no transport.

    role: "controller" or "meter"; asked: what for, in words.
    """
    transport = getattr(instrument, "transport", None)
    if transport is None or getattr(transport, "heard_s", 0.0) is not None:
        return None
    line = _line_in_words(transport.port)
    return (
        f"{port}: nobody answers there; the {role} ({driver}) was asked {asked}{line}. Look whether it is switched on "
        f"and plugged in, whether this is its port (`peltier ports --ask`), and at bench.{role}: driver, baud, options"
    )


def fallen_silent(instrument: Any, now_s: float) -> str:
    """Of an instrument that answered before: for how long nothing has come from it, and what to look at, to be put
    behind what went wrong. "" where something came lately, or where an instrument's own driver has no transport."""
    heard_s = getattr(getattr(instrument, "transport", None), "heard_s", None)
    if heard_s is None or now_s - heard_s < FALLEN_SILENT_S:
        return ""
    return f"; nothing at all has come from it for {now_s - heard_s:.1f} s: look at its supply and its cable"


def _line_in_words(port: Any) -> str:
    """Its settings, as in ", at 9600 baud, 8N1"; nothing of a port that has none."""
    settings = [getattr(port, name, None) for name in ("baudrate", "bytesize", "parity", "stopbits")]
    if None in settings or "://" in str(getattr(port, "port", "")):
        return ""
    baudrate, bytesize, parity, stopbits = settings
    return f", at {baudrate} baud, {bytesize}{parity}{stopbits:g}"
