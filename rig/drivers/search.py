"""Who answers at a port: each driver asks in turn, in its own protocol and at its own line settings.

What is asked changes nothing, but it is sent to whatever is there: only where the user says so.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import Any, NamedTuple

from rig.core.clock import Clock
from rig.core.errors import InstrumentError
from rig.drivers.identity import Identity
from rig.drivers.registry import open_controller, open_meter
from rig.ports.silence import not_understood

# role, driver, options; those whose frames are checked first
TRIED: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("controller", "meerstetter", {}),
    ("controller", "te_technology", {"model": "tc-36-25", "drain_s": 0.1}),
    ("controller", "te_technology", {"model": "tc-48-20", "drain_s": 0.1}),
    ("meter", "keithley2000", {}),
    ("meter", "keithley2400", {}),
    ("meter", "keithley2450", {}),
    ("meter", "hp34401a", {}),
    ("controller", "lakeshore", {}),
    ("controller", "srs_ldc500", {}),
    ("controller", "tclab", {}),
)
# what speaks in lines that end in LF, as instruments on VISA's buses do
ON_VISA = ("keithley2000", "keithley2400", "keithley2450", "hp34401a", "lakeshore", "srs_ldc500")


def _nobody_watches(_text: str) -> None:
    """A port that stays silent costs some seconds a driver, which whoever waits may want to see."""


class Tried(NamedTuple):
    """A driver that asked at a port; who answered it, None where nobody did; and what came instead, in words."""

    driver: str
    identity: Identity | None
    came: str | None = None


def tries(
    port: str, clock: Clock, asks: Callable[[str], None] = _nobody_watches, first: Collection[str] = ()
) -> Iterator[Tried]:
    """Each driver after the other, until somebody answers. PortHeld, Disconnected.

    asks: told, before each is tried, which driver it is and how many there are. first: drivers that are
    likely there."""
    tried = [one for one in TRIED if not port.startswith("visa://") or one[1] in ON_VISA]
    tried.sort(key=lambda one: one[1] not in first)
    for k, (role, driver, options) in enumerate(tried, start=1):
        asks(f"asking as {driver} does ({k} of {len(tried)})")
        opener = open_controller if role == "controller" else open_meter
        instrument = opener(driver, port, clock, **options)
        try:
            identity = instrument.identify()
        except InstrumentError:
            heard = instrument.transport
            yield Tried(driver, None, not_understood(heard.heard, heard.lines))
        else:
            yield Tried(driver, identity)
            return
        finally:
            instrument.transport.close()
