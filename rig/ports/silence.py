"""A port at which nobody answers, or nobody that can be understood, in words: which port, what was asked, what came,
what to look at."""

from __future__ import annotations

from typing import Any

PRINTABLE = {*range(0x20, 0x7F), *b"\r\n\t"}
STRANGE_SHARE = 0.25  # of bytes: a text that lost some on the wire has fewer
ENDS = {b"\r": "CR", b"\n": "LF", b";": "a semicolon", b"\x00": "NUL"}
FALLEN_SILENT_S = 1.0  # several questions in a row: one that is lost is asked again within a tenth of it


def nobody_answers(instrument: Any, port: str, role: str, driver: str, asked: str) -> str | None:
    """The line for it; None where whole lines of text came, or where an instrument's own driver has no transport.

    role: "controller" or "meter"; asked: what for, in words.
    """
    transport = getattr(instrument, "transport", None)
    if transport is None or not hasattr(transport, "heard"):
        return None
    line = _line_in_words(transport.port)
    if transport.heard_s is not None:
        came = not_understood(transport.heard, transport.lines)
        look = f"Look at bench.{role}: driver, baud, options, and at the instrument's menu of its interface"
        return f"{port}: the {role} ({driver}) was asked {asked}{line}, and {came}. {look}" if came else None
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


def not_understood(heard: bytes, lines: int) -> str | None:
    """Why what came from a line is no answer, in words: no text, or no end that is known. None where it may be one.

    heard: its last bytes; lines: how many had the end that an answer has.
    """
    strange = sum(byte not in PRINTABLE for byte in heard)
    if strange > STRANGE_SHARE * len(heard):
        return f"what came is no text, as with another baud rate or parity: {heard!r}"
    if lines or not heard:
        return None
    end = ENDS.get(heard[-1:]) if heard[-2:] != b"\r\n" else "CR LF"
    ends = f"they end in {end}" if end else "they have no end at all"
    return f"bytes came without the end that its answers have; {ends} (its terminator): {heard!r}"
