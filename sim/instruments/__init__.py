"""Byte-level emulators of the instruments: bytes and times in, bytes and times out, no clock and no port."""
