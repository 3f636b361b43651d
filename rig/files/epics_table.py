"""[epics]: what `peltier epics` serves, and who may write."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from rig.files.toml_file import Table

# Beside the prefix a record's name has at most 20 characters, and EPICS has room for 60.
PREFIX = r"^[A-Za-z0-9_.:-]{1,40}$"
TcpPort = Annotated[int, Field(ge=1024, le=65534)]  # the one after it is used as well


def _address(text: str) -> str:
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        raise ValueError("expected an IPv4 address, as in 127.0.0.1; 0.0.0.0: every interface") from None
    return text


def _plain(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_.-]{1,64}", text):
        raise ValueError("expected a name of letters, digits and _ . -")
    return text


Name = Annotated[str, AfterValidator(_plain)]


class EpicsTable(Table):
    """[epics]: the EPICS server of `peltier epics`, see docs/epics.md.

    prefix: of the records' names, before a colon; by default serve.name. address: where it listens; beyond the loopback
    everybody there can read, and STOP. ca_port: Channel Access, TCP and UDP. pva_port: PV Access, TCP; the one after it
    is UDP, for searches. write: whether there are records that start and reset; they are for `users` on `hosts` (each
    means anybody where it is empty; both empty is refused).
    """

    prefix: str | None = Field(default=None, pattern=PREFIX)
    address: Annotated[str, AfterValidator(_address)] = "127.0.0.1"
    ca_port: TcpPort = 5064
    pva_port: TcpPort = 5075
    write: bool = False
    users: list[Name] = []
    hosts: list[Name] = []

    @model_validator(mode="after")
    def _whole(self) -> EpicsTable:
        if self.write and not (self.users or self.hosts):
            raise ValueError("users, hosts: missing; expected who may write, with write = true")
        return self
