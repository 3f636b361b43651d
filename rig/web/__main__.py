"""`python -m rig.web SOCKET`: the web process, begun by the bench process and ended with it."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path

from rig.web.serving import serve

if __name__ == "__main__":
    tell = lambda url: print(f"page {url}", flush=True)  # noqa: E731
    sys.exit(asyncio.run(serve(Path(sys.argv[1]), tell, lambda: os._exit(0))))
