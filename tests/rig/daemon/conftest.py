"""Reports of the daemon's jobs are written with their figures made and not drawn: each is drawn where it is tested."""

import pytest


@pytest.fixture(autouse=True)
def _undrawn(undrawn: None) -> None:
    pass
