"""A name or an origin by which browsers reach a page, as configurations have it. Import-light."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator


def _reachable_name(text: str) -> str:
    if not re.fullmatch(r"(https?://)?([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?", text):
        raise ValueError("expected a name, as in bench.lab.example, or an origin, as in https://bench.lab.example")
    return text


ReachableName = Annotated[str, AfterValidator(_reachable_name)]
