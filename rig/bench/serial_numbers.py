"""Whether the instruments that answer are the ones that the configuration names by their serial numbers."""

from __future__ import annotations

from collections.abc import Mapping

from rig.config.configuration import ConfigurationFile
from rig.drivers.identity import Identity


def strangers(file: ConfigurationFile, identities: Mapping[str, Identity]) -> list[str]:
    """A line for each instrument that is another one than the configuration says by its serial number: two USB adapters
    may have changed places, and with them two benches."""
    tables = {"controller": file.content.bench.controller, "meter": file.content.bench.meter}
    lines = []
    for role, identity in identities.items():
        table = tables[role]
        if table is not None and table.serial_number not in (None, identity.serial_number):
            expected = f"{table.serial_number!r}: what answers at {table.port} is {identity}"
            lines.append(f"{file.path}: bench.{role}.serial_number: {expected}")
    return lines
