"""Listening TCP sockets: of the page, of STOP's own process, of the overview. And why one cannot be had."""

from __future__ import annotations

import socket

CALLERS = 128  # that wait to be accepted


def listening(address: str, port: int) -> socket.socket:
    """A socket that listens at an address (port 0: any free one). Raises OSError; `why_not` tells it."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    return socket.create_server((address, port), family=family, backlog=CALLERS)


def why_not(error: OSError) -> str:
    """The reason alone: Python appends the address to it, which whoever tells it has named already."""
    return (error.strerror or str(error)).partition(" (while attempting")[0]


def stop_listener(address: str, port: int, stop_port: int | None) -> socket.socket:
    """A listening socket for STOP: at the port that is asked for (OSError where that is taken), else at the one after
    the page's, or at any where that is taken."""
    if stop_port is not None:
        return listening(address, stop_port)
    try:
        return listening(address, port + 1 if 0 < port < 65535 else 0)
    except OSError:
        return listening(address, 0)
