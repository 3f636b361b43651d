"""The starlette application: routes, the page's files, protection around all of it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.routing import Mount, Route

from rig.web.answers import Requests
from rig.web.bench_link import BenchLink
from rig.web.names import Names
from rig.web.page_files import PageFiles
from rig.web.protection import Protection, Sessions
from rig.web.replies import Refusal, refused


def application(link: BenchLink, settings: dict[str, Any]) -> Starlette:
    """The bench's interface. settings: what the bench process tells of [serve]."""
    sessions = Sessions(settings["token"], settings["metrics_token"])
    requests = Requests(link, settings, sessions)
    post = ["POST"]
    routes: list[Route | Mount] = [
        Route("/api/state", requests.state),
        Route("/api/events", requests.events),
        Route("/api/history", requests.history),
        Route("/api/loop", requests.loop),
        Route("/api/trips", requests.trips),
        Route("/api/jobs", requests.jobs, methods=["GET"]),
        Route("/api/jobs", requests.submit, methods=post),
        Route("/api/jobs/{number}", requests.cancel, methods=["DELETE"]),
        Route("/api/configurations", requests.configurations),
        Route("/api/stop", requests.stop, methods=post),
        Route("/api/reset", requests.reset, methods=post),
        Route("/api/session", requests.session, methods=post),
        Route("/runs/{number}/{name:path}", requests.report),
        Route("/metrics", requests.metrics),
        Route("/health", requests.health),
    ]
    page = Path(str(resources.files("rig"))) / "page" / "static"
    if page.is_dir():
        routes.append(Mount("/", PageFiles(page, settings["stop_port"])))
    names = Names(settings["address"], settings["hosts"])
    protection = Middleware(Protection, names=names, sessions=sessions)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with link.living(link.follow(), link.tell_now_and_then()):
            yield
        requests.close()

    return Starlette(
        routes=routes,
        middleware=[protection],
        lifespan=lifespan,
        exception_handlers={Refusal: refused, HTTPException: refused},
    )
