"""The overview's configuration: address of its page, and the benches that it shows.

[overview]
port = 8780
token = "..."                        # asked for wherever it is set; needed beyond the loopback
[[bench]]
name = "left"
address = "http://127.0.0.1:8765"    # of the bench's page
token = "..."                        # the bench's own serve.token, where it has one
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, SecretStr, model_validator

from rig.config.schema import HostName, Table, validate
from rig.config.toml_file import parsed_toml, read_text
from rig.core.faults import fault
from rig.web.protection import LOOPBACK

MOST_BENCHES = 200  # on one page: beyond that nobody looks at all of them


def _page_address(text: str) -> str:
    expected = "expected the address of a bench's page, as in http://10.0.0.7:8765"
    if not re.fullmatch(r"https?://([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?/?", text):
        raise ValueError(expected)
    try:
        urlsplit(text).port  # noqa: B018 - it is read when it is asked for, and may be too large
    except ValueError:
        raise ValueError(expected) from None
    return text.rstrip("/")


class BenchTable(Table):
    """[[bench]]: a bench as the overview reaches it."""

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]{1,40}$")
    address: Annotated[str, AfterValidator(_page_address)]
    token: Annotated[SecretStr, Field(min_length=16)] | None = None


class OverviewTable(Table):
    """[overview]: its page; the keys mean what they mean in [serve]."""

    address: str = "127.0.0.1"
    port: int = Field(default=8780, ge=0, le=65535)
    token: Annotated[SecretStr, Field(min_length=16)] | None = None
    hosts: list[HostName] = []


class Overview(Table):
    """The whole file."""

    overview: OverviewTable = OverviewTable()
    bench: list[BenchTable] = Field(min_length=1, max_length=MOST_BENCHES)

    @model_validator(mode="before")
    @classmethod
    def _named_once(cls, data: Any) -> Any:
        tables = data.get("bench") if isinstance(data, dict) else None
        names = [table.get("name") for table in tables if isinstance(table, dict)] if isinstance(tables, list) else []
        twice = sorted({str(name) for name in names if name is not None and names.count(name) > 1})
        if twice:
            raise ValueError(f"bench.name: {', '.join(twice)}: expected each name once")
        return data


def read_overview(path: Path) -> Overview:
    """Read and check the overview's configuration. Raises Faults."""
    content = validate(Overview, parsed_toml(read_text(path), path), path)
    table = content.overview
    if table.address not in LOOPBACK and table.token is None:
        text = f"missing; address {table.address} is not the loopback: expected a token"
        raise fault(path, "overview.token", text)
    return content
