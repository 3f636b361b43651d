"""The page of the bench: plain HTML, CSS and ES modules, and uPlot; no build step, nothing from outside.

`STATIC` is the folder to serve, `OVERVIEW` that of the page for several benches, which finds the other one's files
under `shared/` and its icons under `icons/`. `index.html` belongs at `/` and refers to its neighbours by relative
addresses (`style.css`, `app.js`, `vendor/...`); requests for data go to `/api/...`. `CONTENT_SECURITY_POLICY` is the
strictest header that the page works under: no inline script or style, nothing from another origin, no frame around it.
Who serves the page may add a `connect-src` with the address of STOP's own listener, which the state names as
`stop_port`.
"""

from __future__ import annotations

from pathlib import Path

STATIC = Path(__file__).resolve().parent / "static"
OVERVIEW = STATIC.parent / "overview"

CONTENT_SECURITY_POLICY = (
    "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
)
