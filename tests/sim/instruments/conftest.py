"""The still world that the drivers' tests have."""

from tests.rig.conftest import attach, clock, plant

__all__ = ["attach", "clock", "plant"]
