"""Where a daemon's socket is, so that `stop` finds it without reading a configuration. Import-light.

$PELTIER_SOCKET                       where it is set: this one and no other
$XDG_RUNTIME_DIR/peltier/NAME.sock    a user's own daemon
/run/peltier/NAME.sock                the systemd unit's (RuntimeDirectory=peltier)
/tmp/peltier-UID/NAME.sock            where there is neither
"""

from __future__ import annotations

import os
from pathlib import Path

SYSTEM = Path("/run/peltier")


def _folders() -> list[Path]:
    own = os.environ.get("XDG_RUNTIME_DIR")
    user = os.getuid() if hasattr(os, "getuid") else 0
    fallback = Path(os.environ.get("TMPDIR", "/tmp")) / f"peltier-{user}"
    return ([Path(own) / "peltier"] if own else []) + [SYSTEM, fallback]


def socket_to_make(name: str) -> Path:
    """The socket of a daemon that starts now; its folder is there afterwards, closed to other users.

    OSError where the folder belongs to somebody else.
    """
    given = os.environ.get("PELTIER_SOCKET")
    if given:
        return Path(given)
    runtime = os.environ.get("RUNTIME_DIRECTORY")  # systemd's
    folder = Path(runtime.split(":")[0]) if runtime else next(f for f in _folders() if f != SYSTEM)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
        raise PermissionError(f"{folder} belongs to another user; set PELTIER_SOCKET or XDG_RUNTIME_DIR")
    return folder / f"{name}.sock"


def socket_of(name: str) -> Path:
    """The socket at which the daemon of a name listens, or would: whoever waits for it may ask again."""
    given = os.environ.get("PELTIER_SOCKET")
    if given:
        return Path(given)
    return next((path for path in sockets_there() if path.stem == name), _folders()[0] / f"{name}.sock")


def sockets_there() -> list[Path]:
    """Sockets that daemons may be listening at, the user's own first."""
    given = os.environ.get("PELTIER_SOCKET")
    if given:
        return [Path(given)]
    user = os.getuid() if hasattr(os, "getuid") else 0
    found = []
    for folder in _folders():
        try:
            found += sorted(p for p in folder.glob("*.sock") if p.stat().st_uid in (user, 0) or folder == SYSTEM)
        except OSError:  # not there, or not ours to look into
            continue
    return found
