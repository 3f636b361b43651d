"""The page's own files, with what a browser may do with them."""

from __future__ import annotations

from typing import Any

from starlette.responses import Response
from starlette.staticfiles import StaticFiles

from rig.page import CONTENT_SECURITY_POLICY


class PageFiles(StaticFiles):
    """Static files that run nothing from elsewhere, and are asked for anew after an upgrade."""

    def file_response(self, *arguments: Any, **options: Any) -> Response:
        """The file with its policy; a browser may keep it, but asks whether it still holds."""
        response = super().file_response(*arguments, **options)
        response.headers["Content-Security-Policy"] = CONTENT_SECURITY_POLICY
        response.headers["Cache-Control"] = "no-cache"
        return response
