"""The page's own files, with what a browser may do with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from rig.page import CONTENT_SECURITY_POLICY
from rig.web.names import host_name


class PageFiles(StaticFiles):
    """Static files that run nothing from elsewhere, and are asked for anew after an upgrade. stop_port: the one other
    address that the page may ask, this host's STOP."""

    def __init__(self, folder: Path, stop_port: int | None) -> None:
        super().__init__(directory=folder, html=True)
        self._stop_port = stop_port

    def file_response(self, full_path: Any, stat_result: Any, scope: Scope, status_code: int = 200) -> Response:
        """The file with its policy; a browser may keep it, but asks whether it still holds."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers["Content-Security-Policy"] = CONTENT_SECURITY_POLICY + self._stop_listener(scope)
        response.headers["Cache-Control"] = "no-cache"
        return response

    def _stop_listener(self, scope: Scope) -> str:
        if self._stop_port is None:
            return ""
        host = host_name(Headers(scope=scope).get("host", ""))  # one of this bench's: the protection has seen to that
        return f"; connect-src 'self' http://{host}:{self._stop_port}"
