"""The starlette application: routes, the page's files, protection around all of it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.routing import Mount, Route

from rig.web.answers import Requests
from rig.web.bench_link import BenchLink
from rig.web.page_files import PageFiles
from rig.web.protection import LOOPBACK, Protection, Sessions


def application(link: BenchLink, settings: dict[str, Any]) -> Starlette:
    """The bench's interface. settings: what the bench process tells of [serve]."""
    loopback = settings["address"] in LOOPBACK
    hosts = {name.lower() for name in settings["hosts"]} | LOOPBACK
    if not loopback and settings["address"] not in ("0.0.0.0", "::"):
        hosts.add(settings["address"].lower())
    sessions = Sessions(settings["token"])
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
        routes.append(Mount("/", PageFiles(directory=page, html=True)))
    protection = Middleware(Protection, hosts=hosts, needs_token=not loopback, sessions=sessions)
    return Starlette(routes=routes, middleware=[protection], lifespan=_lifespan(link))


def _lifespan(link: BenchLink) -> Any:
    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(link.follow()), asyncio.create_task(link.tell_now_and_then())]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks, timeout=1.0)
            await link.close()

    return lifespan
