"""MeCom frames, the device's side: requests taken apart, replies put together.

Source: Meerstetter "MeCom Protocol Specification" 5117C, sections on frame and CRC.

    request   #  address(2)  sequence(4)  payload  crc(4)  CR
    reply     !  address(2)  sequence(4)  payload  crc(4)  CR      payload `+` and two digits: an error
    ACK       !  address(2)  sequence(4)           crc(4)  CR      the crc is that of the request

All numbers are upper-case hexadecimal. The CRC is CRC-16/XMODEM (polynomial 0x1021, initial value 0, most
significant bit first) over everything before it.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx, unhexlify

SHORTEST_REQUEST = 13  # '#', address, sequence, two characters of payload, crc
(
    UNKNOWN_COMMAND,
    BUSY,
    GENERAL,
    FORMAT,
    UNKNOWN_PARAMETER,
    READ_ONLY,
    OUT_OF_RANGE,
    UNKNOWN_INSTANCE,
    FAILURE,
) = range(1, 10)

_float32 = struct.Struct(">f")
_int32 = struct.Struct(">i")


def request(line: bytes) -> tuple[bytes, bytes, bytes] | None:
    """A line without its CR, taken apart: (address and sequence, payload, crc); None where it is no valid
    frame.

    `#` restarts a frame, so garbage before it is dropped. A wrong CRC is met with silence (not specified by
    the maker; every known client expects it).
    """
    start = line.rfind(b"#")
    if start:
        if start < 0:
            return None
        line = line[start:]
    if len(line) < SHORTEST_REQUEST:
        return None
    body = line[:-4]
    crc = line[-4:]
    if b"%04X" % crc_hqx(body, 0) != crc:
        return None
    return body[1:7], body[7:], crc


def reply(head: bytes, payload: bytes) -> bytes:
    """A data frame with its CR; `head` is the request's address and sequence, which the device echoes."""
    body = b"!" + head + payload
    return b"%b%04X\r" % (body, crc_hqx(body, 0))


def acknowledgement(head: bytes, crc: bytes) -> bytes:
    """An ACK with its CR: it carries the CRC of the request that it acknowledges."""
    return b"!" + head + crc + b"\r"


def error(head: bytes, code: int) -> bytes:
    """An error frame with its CR; `code` as in 5117C (1 unknown command ... 9 parameter failure)."""
    return reply(head, b"+%02X" % code)


def float32_text(value: float) -> bytes:
    """IEEE-754 single as 8 hexadecimal digits; what is beyond its range becomes infinite."""
    try:
        return _float32.pack(value).hex().upper().encode()
    except OverflowError:
        return b"7F800000" if value > 0 else b"FF800000"


def int32_text(value: float) -> bytes:
    """Two's complement as 8 hexadecimal digits."""
    return _int32.pack(int(value)).hex().upper().encode()


def float32_value(text: bytes) -> float:
    """Value of 8 hexadecimal digits; ValueError where they are not."""
    value: float = _float32.unpack(_four_bytes(text))[0]
    return value


def int32_value(text: bytes) -> int:
    """Value of 8 hexadecimal digits; ValueError where they are not."""
    value: int = _int32.unpack(_four_bytes(text))[0]
    return value


def _four_bytes(text: bytes) -> bytes:
    if len(text) != 8:
        raise ValueError(f"8 hexadecimal digits expected, not {text!r}")
    return unhexlify(text)  # strict: a sign or a blank is an error (binascii.Error is a ValueError)
