"""By which names this bench is reached, and from which pages it may be asked.

the bench's own address, the loopback's names     http, at the port that was asked
numbers, where it listens beyond the loopback     the same; no other site's name is a number
"bench.lab.example" in serve.hosts                http or https, at the port that was asked
"https://bench.lab.example" in serve.hosts        exactly this origin, whatever its proxy says who was asked
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable

LOOPBACK = {"127.0.0.1", "localhost", "::1", "[::1]"}
EVERYWHERE = {"0.0.0.0", "::"}


class Names:
    """address, hosts: of [serve]. page_port: where the page's own address differs from the one asked, as for STOP's own
    listener, the port that its origin has; 0: any."""

    def __init__(self, address: str, hosts: Iterable[str], page_port: int | None = None) -> None:
        self._numbers = address not in LOOPBACK
        self._page_port = page_port
        self._own = LOOPBACK | ({address.lower()} if address not in EVERYWHERE else set())
        given = [host.lower() for host in hosts]
        self._origins = {host for host in given if "://" in host}
        self._named = {host_name(host) for host in given if "://" not in host}
        self._reached = self._own | self._named | {host_name(host.partition("://")[2]) for host in self._origins}

    def reach(self, host: str) -> bool:
        """Whether a Host header is one of this bench's."""
        name = host_name(host)
        return name in self._reached or (self._numbers and _is_number(name))

    def allow(self, origin: str, host: str) -> bool:
        """Whether a page of an origin may ask, where the request was sent to `host`."""
        origin, name = origin.lower(), host_name(host)
        if origin in self._origins:
            return True
        scheme, _, place = origin.partition("://")
        schemes = {"http", "https"} if name in self._named else {"http"} if self._is_own(name) else set()
        if scheme not in schemes:
            return False
        if self._page_port is None:
            return place == host.lower()
        port = place[len(name) :]
        return host_name(place) == name and (not self._page_port or port in (f":{self._page_port}", ""))

    def _is_own(self, name: str) -> bool:
        return name in self._own or (self._numbers and _is_number(name))


def host_name(text: str) -> str:
    """The name in a Host header, without its port."""
    if text.startswith("["):
        return text.partition("]")[0].lower() + "]"
    return text.partition(":")[0].lower()


def _is_number(host: str) -> bool:
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True
