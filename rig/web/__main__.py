"""`python -m rig.web SOCKET [LISTENER]`: a web process, started by the bench process and ended with it.

LISTENER: the descriptor of a listening TCP socket, for the process that takes STOP and nothing else.
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
from pathlib import Path

from rig.web.serving import serve

NICENESS = 5  # of the page's process: on a busy computer the bench's, STOP's and `peltier stop` go first

if __name__ == "__main__":
    report = lambda url: print(f"page {url}", flush=True)  # noqa: E731
    listener = socket.socket(fileno=int(sys.argv[2])) if len(sys.argv) > 2 else None
    if listener is None:
        os.nice(NICENESS)
    sys.exit(asyncio.run(serve(Path(sys.argv[1]), report, lambda: os._exit(0), listener)))
