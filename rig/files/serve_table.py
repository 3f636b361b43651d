"""[serve]: the bench daemon."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, SecretStr

from rig.files.bounded_numbers import Days
from rig.files.reachable_name import ReachableName
from rig.files.toml_file import Table


def _web_address(secret: SecretStr) -> SecretStr:
    if not re.fullmatch(r"https?://[!-~]+", secret.get_secret_value()):
        raise ValueError("expected an address that begins with http:// or https://")
    return secret


class ServeTable(Table):
    """[serve]: the bench daemon, see docs/daemon.md.

    folder: run folders and history.sqlite; configurations: those that may be started; both beside this file, by
    default runs/ where the daemon was started, and this file's folder. token: asked for wherever it is set, on the
    loopback too, where a proxy's visitors come from; addresses beyond the loopback need one. metrics_token: opens
    /metrics and nothing else. hosts: further names or origins ("https://bench.lab.example") by which browsers reach it.
    port 0: any that is free. stop_port: of the listener that takes nothing but STOP; by default the one after `port`.
    diagnose: "nightly" has `peltier trend` look at the runs from diagnose_hour on, while nothing runs.
    """

    name: str = Field(default="bench", pattern=r"^[A-Za-z0-9_-]{1,40}$")
    address: str = "127.0.0.1"
    port: int = Field(default=8765, ge=0, le=65535)
    stop_port: int | None = Field(default=None, ge=0, le=65535)
    token: Annotated[SecretStr, Field(min_length=16)] | None = None
    metrics_token: Annotated[SecretStr, Field(min_length=16)] | None = None
    hosts: list[ReachableName] = []
    folder: str | None = None
    configurations: str = "."
    idle_period_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    raw_days: Days = 30.0
    minute_days: Days = 400.0
    hour_days: Days = 4000.0
    webhook: Annotated[SecretStr, AfterValidator(_web_address)] | None = None
    diagnose: Literal["never", "nightly"] = "never"
    diagnose_hour: Annotated[int, Field(ge=0, le=18)] = 3
