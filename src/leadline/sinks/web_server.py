"""The live page's server, in its own thread: fixed files, one websocket, the run as a download.

Nothing that comes over the network is ever a path: what can be asked for stands in a table that is made at the start.
"""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.requests import Request, cookie_parser
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketClose, WebSocketDisconnect

from leadline.errors import InputError
from leadline.samples import Image
from leadline.sinks.control import Wish
from leadline.sinks.web_access import Access, Place
from leadline.sinks.web_page import Seen, Shot, Shown
from leadline.sinks.web_scene import SIDES
from leadline.wire.archive import zipped
from leadline.wire.images import encode_jpeg

PAGE = Path(__file__).parents[1] / "page"
MEDIA = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
CLIENTS, MESSAGE_BYTES = 8, 4096
PERIOD_S = 1 / 12  # between two messages to a client
LOOK_S = 0.015  # how often a client's task looks for news
BEAT_S = 1.0  # something is said at least so often
UNSHOWN = 2  # messages under way to a page that has not drawn them yet
GONE_S = 15.0  # a page that has drawn nothing for so long is gone
WIDTH_PX, QUALITY = 640, 80
SAFE = {
    "content-security-policy": "default-src 'self'; img-src 'self' blob:; frame-ancestors 'none'; form-action 'self'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
LOGIN = (PAGE / "login.html").read_bytes()


class PageServer:
    """Bound when made (InputError where that cannot be), serving from ``start`` to ``close``."""

    def __init__(self, sink: Shown, place: Place, token: str | None, files: Callable[[], Sequence[Path]]) -> None:
        self._sink, self._token, self._files = sink, token, files
        self._socket = _bind(place)
        self.host, self.port = place.host, self._socket.getsockname()[1]
        self._cookie = f"leadline_{self.port}"  # cookies know no port
        self._pictures = _Pictures(sink)
        self.clients = 0
        config = uvicorn.Config(
            self._app(),
            log_config=None,
            access_log=False,
            lifespan="off",
            http="h11",
            ws="websockets-sansio",
            ws_max_size=MESSAGE_BYTES,
            ws_per_message_deflate=False,  # the pictures are compressed already
            h11_max_incomplete_event_size=16384,
            limit_concurrency=64,
            timeout_keep_alive=10,
            timeout_graceful_shutdown=1,
            server_header=False,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._serve, name="leadline-page", daemon=True)

    @property
    def url(self) -> str:
        """For a browser; with the token, where one is needed."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        host = {"0.0.0.0": _own_address(), "[::]": "[::1]"}.get(host, host)
        return f"http://{host}:{self.port}/" + ("" if self._token is None else f"?token={self._token}")

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    def start(self) -> None:
        self._thread.start()
        while not self._server.started and self._thread.is_alive():
            time.sleep(0.01)

    def close(self) -> None:
        """Safe to call twice."""
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join(5.0)
        self._socket.close()

    def _serve(self) -> None:
        asyncio.run(self._server.serve(sockets=[self._socket]))

    def _app(self) -> ASGIApp:
        files = [
            Route(f"/{path.relative_to(PAGE).as_posix()}", _fixed(path)) for path in sorted(PAGE.rglob("*"))
            if path.suffix in MEDIA and path.suffix != ".html"
        ]  # fmt: skip
        routes = [
            Route("/", self._index(PAGE / self._sink.page)),
            Route("/alive", self._alive),
            Route("/run.zip", self._download),
            WebSocketRoute("/live", self._live),
            *files,
        ]
        return _Guard(Starlette(routes=routes), Access(self._token), self._cookie)

    def _index(self, path: Path) -> Callable[[Request], Any]:
        page = path.read_bytes()

        async def index(request: Request) -> Response:
            if "token" not in request.query_params:
                return Response(page, media_type="text/html")
            response = RedirectResponse("/", status_code=303)  # so that the token does not stay in the address bar
            if self._token is not None:
                response.set_cookie(self._cookie, self._token, httponly=True, samesite="lax", max_age=30 * 86400)
            return response

        return index

    async def _alive(self, request: Request) -> Response:
        return JSONResponse({})

    async def _download(self, request: Request) -> Response:
        disposition = {"content-disposition": 'attachment; filename="run.zip"'}
        return StreamingResponse(zipped(self._files()), media_type="application/zip", headers=disposition)

    async def _live(self, websocket: WebSocket) -> None:
        if self.clients >= CLIENTS:
            await websocket.close(1013, "too many pages are open")
            return
        await websocket.accept()
        self.clients += 1
        client = _Client(websocket, self._sink, self._pictures)
        telling = asyncio.ensure_future(client.tell())
        listening = asyncio.ensure_future(client.listen())
        try:
            await asyncio.wait((telling, listening), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.clients -= 1
            for task in (telling, listening):
                task.cancel()
            ends = await asyncio.gather(telling, listening, return_exceptions=True)
        for end in ends:
            if isinstance(end, Exception) and not isinstance(end, WebSocketDisconnect):
                raise end


class _Client:
    """One open page: told what is new as fast as it draws, never faster."""

    def __init__(self, websocket: WebSocket, sink: Shown, pictures: _Pictures) -> None:
        self._websocket, self._sink, self._pictures = websocket, sink, pictures
        self._seen = Seen()
        self._sent = self._shown = 0
        self._shown_s = time.monotonic()

    async def tell(self) -> None:
        await self._send(self._sink.hello())
        told_s = 0.0
        while time.monotonic() - self._shown_s < GONE_S:
            await asyncio.sleep(LOOK_S)
            waited_s = time.monotonic() - told_s
            if waited_s < PERIOD_S or self._sent - self._shown >= UNSHOWN:
                continue
            news = self._sink.news(self._seen)
            if news is None and waited_s < BEAT_S:
                continue
            told_s = time.monotonic()
            await self._send({"silent_s": round(self._sink.silent_s, 1), **(news or {"kind": "beat"})}, self._newest())

    async def listen(self) -> None:
        with suppress(
            WebSocketDisconnect, ArithmeticError, LookupError, RecursionError, TypeError, ValueError
        ):  # one who talks nonsense is hung up on
            while True:
                said = json.loads(await self._websocket.receive_text())
                if "shown" in said:
                    self._shown, self._shown_s = min(int(said["shown"]), self._sent), time.monotonic()
                else:
                    self._sink.control.ask(Wish(said["do"]), str(said.get("text", "")))

    def _newest(self) -> Shot | None:
        picture: Shot | None = self._sink.picture
        if picture is None or picture.number == self._seen.picture:
            return None
        self._seen.picture = picture.number
        return picture

    async def _send(self, told: dict[str, Any], picture: Shot | None = None) -> None:
        """One message: the header's length (uint32, big endian), the header (JSON), the pictures (JPEG)."""
        self._sent += 1
        scene, images = self._pictures.of(picture)
        head = json.dumps(
            {"n": self._sent, **told, **scene, "bytes": [len(one) for one in images]}, allow_nan=False
        ).encode()
        await self._websocket.send_bytes(struct.pack(">I", len(head)) + head + b"".join(images))


class _Pictures:
    """Each picture is drawn and compressed once, however many pages are open."""

    def __init__(self, sink: Shown) -> None:
        self._sink = sink
        self._number = 0
        self._made: tuple[dict[str, Any], list[bytes]] = {}, []

    def of(self, picture: Shot | None) -> tuple[dict[str, Any], list[bytes]]:
        """What to draw over the two images, and their JPEGs."""
        if picture is None:
            return {}, []
        if picture.number != self._number:
            scene = self._sink.scene(picture)
            images = [encode_jpeg(_smaller(getattr(picture.frame, side)), QUALITY) for side in SIDES]
            self._number, self._made = picture.number, ({"scene": scene}, images)
        return self._made


class _Guard:
    """Before everything else: who asks, and by which name."""

    def __init__(self, app: ASGIApp, access: Access, cookie: str) -> None:
        self._app, self._access, self._cookie = app, access, cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        acts = scope["type"] == "websocket"
        refusal = self._access.refusal(headers, self._offered(scope, headers), acts=acts)
        if refusal is None:
            await self._app(scope, receive, send if acts else _safely(send))
        elif acts:
            await WebSocketClose(1008, refusal[1])(scope, receive, send)
        else:
            status, words = refusal
            page, kind = (LOGIN, "text/html") if status == 401 else (words, "text/plain")
            await Response(page, status, media_type=kind)(scope, receive, _safely(send))

    def _offered(self, scope: Scope, headers: Headers) -> str:
        """From the address, the cookie that it left, or a header (for programs)."""
        query = QueryParams(scope["query_string"]).get("token")
        bearer = headers.get("authorization", "").removeprefix("Bearer ")
        return query or cookie_parser(headers.get("cookie", "")).get(self._cookie) or bearer


def _safely(send: Send) -> Send:
    async def sender(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in SAFE.items():
                headers[name] = value
        await send(message)

    return sender


def _fixed(path: Path) -> Callable[[Request], Any]:
    content, media = path.read_bytes(), MEDIA[path.suffix]

    async def file(request: Request) -> Response:
        return Response(content, media_type=media)

    return file


def _smaller(image: Image) -> Image:
    height, width = image.shape[:2]
    if width <= WIDTH_PX:
        return image
    size = (WIDTH_PX, max(round(height * WIDTH_PX / width), 1))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


def _bind(place: Place) -> socket.socket:
    family = socket.AF_INET6 if ":" in place.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((place.host, place.port))
    except OSError as error:
        listener.close()
        fix = "end the other program (another run with --view?), or give --view-at 127.0.0.1:0 for any free port"
        raise InputError(
            f"cannot serve the page there ({error.strerror})", f"{place.host}:{place.port}", fix
        ) from error
    listener.listen(64)
    return listener


def _own_address() -> str:
    """The address by which others reach this computer, as far as it knows; no packet is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect(("192.0.2.1", 9))
        return str(probe.getsockname()[0])
    return "127.0.0.1"
