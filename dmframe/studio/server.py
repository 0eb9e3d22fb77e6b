"""The studio as an ASGI application: the page, the file, the stages of a text, events.

Only the local user may use it: each request needs the token of this server, as a cookie that the first address sets,
and the host and origin of this server, so that no other web page, and no other name of this computer, can send one. It
serves one file, the packaged graphs, and its own scripts by a fixed table; no path is taken from a request.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import secrets
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, final

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from dmframe.common.errors import OutputError
from dmframe.studio.client import Stage, Worker
from dmframe.studio.file import MOST_BYTES, ChangedError, File
from dmframe.studio.watch import changes

STATIC: Final = {
    "studio.css": "text/css",
    "studio.js": "text/javascript",
    "complete.js": "text/javascript",
    "editor.min.js": "text/javascript",
    "editor.licences.txt": "text/plain",
}
MOST_BODY: Final = 8 * MOST_BYTES
"""Size limit of a request: two texts with each character escaped [bytes]."""
MOST_PAGES: Final = 24
"""Live pages that are kept; an older one is computed again when it is shown."""
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
PAGE_POLICY: Final = "sandbox allow-scripts; frame-ancestors 'self'"
"""A live page cannot read the studio, its cookie, or the file; its own policy allows its own script alone."""
HEADERS: Final = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}


@final
class Guard:
    """Middleware that refuses requests of others.

    Parameters
    ----------
    hosts
        Values of the header ``Host`` with which this server may be called.
    """

    def __init__(self, app: ASGIApp, token: str, hosts: tuple[str, ...], cookie: str) -> None:
        self.app, self.token, self.hosts, self.cookie = app, token, hosts, cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer it."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        request = Request(scope)
        refused = self._refused(request)
        if refused is not None:
            await refused(scope, receive, send)
            return
        await self.app(scope, receive, send)

    def _refused(self, request: Request) -> Response | None:
        host, origin = request.headers.get("host", ""), request.headers.get("origin")
        if host not in self.hosts:
            return _plain("unknown host: open the address that dmframe studio printed", 403)
        if origin is not None and origin not in [f"http://{each}" for each in self.hosts]:
            return _plain("another web page may not use the studio", 403)
        given = request.query_params.get("token")
        if given is not None and request.url.path == "/" and self._is(given):
            answer = RedirectResponse("/", 303, headers=HEADERS)
            answer.set_cookie(self.cookie, self.token, httponly=True, samesite="strict")
            return answer
        if not self._is(request.cookies.get(self.cookie, "")):
            return _plain("no access: open the address with the token that dmframe studio printed", 403)
        return None

    def _is(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())


def _plain(text: str, status: int) -> Response:
    return PlainTextResponse(text + "\n", status, headers=HEADERS)


@final
class Studio:
    """The answers of the server about one file."""

    def __init__(self, path: Path) -> None:
        self.file, self.worker = File(path), Worker(path)
        self.pages: OrderedDict[str, str] = OrderedDict()
        self.listeners = set[asyncio.Queue[Stage]]()
        self.ending = asyncio.Event()
        self.saving = asyncio.Lock()

    @asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Watch the folder, and end the worker with the server."""
        await self.worker.start()
        watching = asyncio.create_task(self._watch())
        try:
            yield
        finally:
            self.end()
            watching.cancel()
            with suppress(asyncio.CancelledError):
                await watching
            await self.worker.close()

    def end(self) -> None:
        """End all open streams, for which the server would wait."""
        self.ending.set()
        self.publish({"event": "end"})
        self.worker.end_jobs("the studio has ended")

    def publish(self, event: Stage) -> None:
        """Send an event to all tabs."""
        for queue in self.listeners:
            queue.put_nowait(event)

    async def _watch(self) -> None:
        async for own in changes(self.file.path, self.ending):
            self.publish({"event": "file" if own else "neighbour", "version": self.file.read().version})

    async def home(self, _: Request) -> Response:
        """The page."""
        return Response(
            _web("studio.html"), media_type="text/html", headers={**HEADERS, "Content-Security-Policy": POLICY}
        )

    async def static(self, request: Request) -> Response:
        """A script or a style."""
        name = request.path_params["name"]
        if name not in STATIC:
            return _plain("not found", 404)
        return Response(_web(name), media_type=STATIC[name], headers=HEADERS)

    async def content(self, _: Request) -> Response:
        """The file as it is now."""
        now = self.file.read()
        return _json({**now.data, "name": self.file.path.name, "writable": self.file.writable})

    async def lists(self, _: Request) -> Response:
        """Schema of graph files and names of packaged graphs."""
        async for stage in self.worker.stages({"part": "list"}):
            if stage["stage"] == "list":
                return _json({"schema": stage["schema"], "graphs": stage["graphs"]})
        return _plain("the lists could not be read", 500)

    async def examine(self, request: Request) -> Response:
        """The stages of a text or of a packaged graph, one JSON object a line; a disconnect stops the work."""
        given = await _body(request)
        if isinstance(given, Response):
            return given
        wanted = {key: given[key] for key in ("text", "base", "graph") if isinstance(given.get(key), str)}
        if ("text" in wanted) == ("graph" in wanted):
            return _plain("expected a text or the name of a graph", 400)
        return StreamingResponse(self._stages(wanted), media_type="application/x-ndjson", headers=HEADERS)

    async def _stages(self, wanted: Stage) -> AsyncIterator[bytes]:
        async for stage in self.worker.stages(wanted):
            shown = {key: value for key, value in stage.items() if key not in ("html", "files")}
            if "html" in stage:
                shown["page"] = self._page(stage["html"])
            yield json.dumps(shown).encode() + b"\n"

    def _page(self, html: str) -> str:
        name = hashlib.sha256(html.encode()).hexdigest()[:32]
        self.pages[name] = html
        self.pages.move_to_end(name)
        while len(self.pages) > MOST_PAGES:
            self.pages.popitem(last=False)
        return name

    async def page(self, request: Request) -> Response:
        """A live page."""
        html = self.pages.get(request.path_params["name"])
        if html is None:
            return _plain("this page is no longer kept; edit the text to compute it again", 404)
        return Response(html, media_type="text/html", headers={**HEADERS, "Content-Security-Policy": PAGE_POLICY})

    async def save(self, request: Request) -> Response:
        """Write the file, if it is the version that the edit began with."""
        given = await _body(request)
        if isinstance(given, Response):
            return given
        text, version = given.get("text"), given.get("version")
        if not isinstance(text, str) or not isinstance(version, str):
            return _plain("expected a text and the version that it began with", 400)
        async with self.saving:
            try:
                saved = self.file.save(text, version)
            except ChangedError as error:
                return _json({"reason": error.text, "now": error.now.data}, 409)
            except OutputError as error:
                return _json({"reason": error.text}, 422)
        self.publish({"event": "file", "version": saved.version})
        return _json({"version": saved.version})

    async def events(self, _: Request) -> Response:
        """Changes of the file, and of files in its folder, as server-sent events."""
        return StreamingResponse(self._events(), media_type="text/event-stream", headers=HEADERS)

    async def _events(self) -> AsyncIterator[str]:
        queue = asyncio.Queue[Stage]()
        self.listeners.add(queue)
        try:
            yield f"data: {json.dumps({'event': 'file', 'version': self.file.read().version})}\n\n"
            while not self.ending.is_set():
                yield f"data: {json.dumps(await queue.get())}\n\n"
        finally:
            self.listeners.discard(queue)


def application(path: Path, token: str, port: int) -> tuple[Starlette, Studio]:
    """The application for a file, and its state."""
    studio = Studio(path)
    get: list[tuple[str, Callable[[Request], Awaitable[Response]]]] = [
        ("/", studio.home),
        ("/static/{name}", studio.static),
        ("/file", studio.content),
        ("/lists", studio.lists),
        ("/page/{name}", studio.page),
        ("/events", studio.events),
    ]
    hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
    app = Starlette(
        routes=[
            *(Route(place, answer, methods=["GET"]) for place, answer in get),
            Route("/examine", studio.examine, methods=["POST"]),
            Route("/save", studio.save, methods=["POST"]),
        ],
        middleware=[Middleware(Guard, token=token, hosts=hosts, cookie=f"dmframe_studio_{port}")],
        lifespan=studio.lifespan,
    )
    return app, studio


async def _body(request: Request) -> Stage | Response:
    """The JSON object of a request, or the answer that refuses it."""
    raw = b""
    try:
        async for chunk in request.stream():
            raw += chunk
            if len(raw) > MOST_BODY:
                return _plain(f"a request may have {MOST_BODY} bytes", 413)
        given = json.loads(raw)
    except ClientDisconnect:
        return _plain("disconnected", 400)
    except (ValueError, RecursionError):
        given = None
    return given if isinstance(given, dict) else _plain("expected a JSON object", 400)


def _json(data: Any, status: int = 200) -> Response:
    return JSONResponse(data, status, headers=HEADERS)


def _web(name: str) -> bytes:
    return files("dmframe.studio").joinpath("web", name).read_bytes()
