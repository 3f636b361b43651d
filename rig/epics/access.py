"""EPICS access security: who may write which records, and where the server listens.

Everybody who reaches the server may read, and write STOP. The other records may be written by the users and hosts of a
list. Only a record's value can be written, never a field of its configuration (ASL 0 in EPICS). A host is identified by
the address of its packets; a user is the one that the client names.
"""

from __future__ import annotations

import ipaddress
from collections.abc import MutableMapping

from rig.config.tables import EpicsTable

READ, STOP, WRITE = "DEFAULT", "STOP", "WRITE"  # groups of records
EVERYWHERE = "0.0.0.0"


def access_list(table: EpicsTable) -> str:
    """Return the access-security file (.acf)."""
    lines, conditions = [], []
    for kind, group, names in (("UAG", "writers", table.users), ("HAG", "consoles", table.hosts)):
        if names:
            lines.append(f"{kind}({group}) {{ {', '.join(names)} }}")
            conditions.append(f"{kind}({group})")
    lines += [f"ASG({READ}) {{ RULE(1, READ) }}", f"ASG({STOP}) {{ RULE(1, READ) RULE(0, WRITE) }}"]
    if table.write:
        lines.append(f"ASG({WRITE}) {{ RULE(1, READ) RULE(0, WRITE) {{ {' '.join(conditions)} }} }}")
    return "\n".join(lines) + "\n"


def listen(table: EpicsTable, environment: MutableMapping[str, str]) -> None:
    """Set EPICS' variables for where the server listens and announces itself."""
    environment["EPICS_CAS_SERVER_PORT"] = str(table.ca_port)
    environment["EPICS_PVAS_SERVER_PORT"] = str(table.pva_port)
    environment["EPICS_PVAS_BROADCAST_PORT"] = str(table.pva_port + 1)
    if table.address == EVERYWHERE:
        return
    loopback = ipaddress.IPv4Address(table.address).is_loopback
    for server in ("CAS", "PVAS"):
        environment[f"EPICS_{server}_INTF_ADDR_LIST"] = table.address
        if loopback:  # no other computer can reach it
            environment[f"EPICS_{server}_AUTO_BEACON_ADDR_LIST"] = "NO"
            environment[f"EPICS_{server}_BEACON_ADDR_LIST"] = table.address
