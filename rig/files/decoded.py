"""The text of a file from its bytes: UTF-8, UTF-16, or what instruments and spreadsheets wrote before those.

Numbers are the same bytes in all of the older encodings; only names and units differ. The older ones are told apart by
what they make of the bytes: letters of Western names, signs of units, or the words of a Japanese or Chinese header.
"""

from __future__ import annotations

import codecs
from pathlib import Path

from rig.core.faults import fault

MARKS = (  # the longer marks first: UTF-32's begins as UTF-16's does
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
WESTERN = frozenset("°µ²³±·×ºäöüÄÖÜßéèêëàâçîïôûùÉÈÀÇñóíáúÑåøæÅØÆãõ–—…’“”«»§\u00a0")
WORDS = {
    "cp932": ("時間", "時刻", "日時", "温度", "抵抗", "電流", "℃"),
    "gb18030": ("时间", "日期", "温度", "电阻", "电流", "℃"),
}
PROBE_BYTES = 200_000  # names and units stand at the beginning


def decoded(data: bytes, path: Path) -> tuple[str, str]:
    """The text, and its encoding where that is none of UTF. Raises Faults."""
    for mark, encoding in MARKS:
        if data.startswith(mark):
            return _strict(data, encoding, path), ""
    if encoding := _wide(data):
        return _strict(data, encoding, path), ""
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise fault(path, f"line {line}", "a NUL byte; expected text (was the file cut off while it was written?)")
    try:
        return data.decode("utf-8"), ""
    except UnicodeDecodeError as error:
        beyond = error.start
    return _older(data, path, beyond)


def _strict(data: bytes, encoding: str, path: Path) -> str:
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        raise fault(path, f"byte {error.start}", f"expected {encoding.upper()}, as its first bytes say") from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise fault(path, f"line {line}", "a NUL; expected text")
    return text


def _wide(data: bytes) -> str:
    """UTF-16 without a mark: every second byte of the beginning is 0, for it is digits and separators."""
    head = data[:1000]
    if len(head) < 8:
        return ""
    even, odd = head[0::2].count(0), head[1::2].count(0)
    half = len(head) // 2
    if odd > 0.8 * half and even < 0.1 * half:
        return "utf-16-le"
    return "utf-16-be" if even > 0.8 * half and odd < 0.1 * half else ""


def _older(data: bytes, path: Path, beyond: int) -> tuple[str, str]:
    """Text of before UTF-8. Raises Faults where no encoding makes sense of it."""
    head = data[: max(PROBE_BYTES, beyond + 1000)]
    control = sum(head.count(bytes([byte])) for byte in range(32) if byte not in (9, 10, 11, 12, 13, 26))
    if control > 0.01 * len(head) + 2:
        raise fault(path, f"byte {beyond}", "no text; expected a table in UTF-8, UTF-16 or a code page, .xlsx or .mat")
    for encoding, words in WORDS.items():
        text = head.decode(encoding, errors="replace")
        if any(word in text for word in words):
            return data.decode(encoding, errors="replace"), encoding
    strange = {c for c in head.decode("cp1252", errors="replace") if not c.isascii()} - WESTERN
    mac = {c for c in head.decode("mac_roman") if not c.isascii()} - WESTERN - {"Ω", "µ"}
    if strange and not mac:
        return data.decode("mac_roman"), "Mac Roman"
    return data.decode("cp1252", errors="replace"), "cp1252"
