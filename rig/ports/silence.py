"""A port at which nobody answers, in words: which port, what was asked, what to look at."""

from __future__ import annotations

from typing import Any


def nobody_answers(instrument: Any, port: str, role: str, driver: str, asked: str) -> str | None:
    """The line for it; None where anything at all was heard, or where an instrument's own driver has no transport.

    role: "controller" or "meter"; asked: what for, in words.
    """
    transport = getattr(instrument, "transport", None)
    if transport is None or getattr(transport, "heard", True):
        return None
    line = _line_in_words(transport.port)
    return (
        f"{port}: nobody answers there; the {role} ({driver}) was asked {asked}{line}. Look whether it is switched on "
        f"and plugged in, whether this is its port (`peltier ports --ask`), and at bench.{role}: driver, baud, options"
    )


def _line_in_words(port: Any) -> str:
    """Its settings, as in ", at 9600 baud, 8N1"; nothing of a port that has none."""
    settings = [getattr(port, name, None) for name in ("baudrate", "bytesize", "parity", "stopbits")]
    if None in settings or "://" in str(getattr(port, "port", "")):
        return ""
    baudrate, bytesize, parity, stopbits = settings
    return f", at {baudrate} baud, {bytesize}{parity}{stopbits:g}"
