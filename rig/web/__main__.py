"""`python -m rig.web SOCKET [LISTENER]`: a web process, begun by the bench process and ended with it.

LISTENER: the descriptor of a listening TCP socket, for the process that takes STOP and nothing else.
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
from pathlib import Path

from rig.web.serving import serve

BEHIND = 5  # the page's process lets the bench's, STOP's and `peltier stop` go first where processors are short

if __name__ == "__main__":
    tell = lambda url: print(f"page {url}", flush=True)  # noqa: E731
    listener = socket.socket(fileno=int(sys.argv[2])) if len(sys.argv) > 2 else None
    if listener is None:
        os.nice(BEHIND)
    sys.exit(asyncio.run(serve(Path(sys.argv[1]), tell, lambda: os._exit(0), listener)))
