"""Who an instrument says it is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Identity:
    """As the instrument tells it; empty where it does not."""

    maker: str
    model: str
    serial_number: str
    firmware: str

    def __str__(self) -> str:
        return f"{self.maker} {self.model}, serial number {self.serial_number}, firmware {self.firmware}"
