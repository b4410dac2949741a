"""The server of the page: its files, and one connection for each tab."""

import asyncio
import ipaddress
import json
import logging
import math
import secrets
import socket
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib import resources
from urllib.parse import urlsplit

import tornado.httpserver
import tornado.netutil
import tornado.web
import tornado.websocket

from mishutter._core.checks import own_message
from mishutter._core.validation import validated
from mishutter.explore.fields import page_fields
from mishutter.explore.pictures import MOST_BYTES
from mishutter.explore.session import (
    MOST_PINS,
    MOST_ROWS,
    NUM_CHIPS,
    Answer,
    Beginning,
    Order,
    Request,
    Session,
    SupersededError,
    with_design,
)

MOST_TABS = 16
MOST_SESSIONS = 2 * MOST_TABS
"""Most sessions in memory, of open and closed tabs; a tab that is reloaded resumes its own."""
_MOST_MESSAGE = 2 << 20
"""Bytes of a message of text."""
_PAGE = {
    "/": ("index.html", "text/html"),
    "/explore.js": ("explore.js", "text/javascript"),
    "/charts.js": ("charts.js", "text/javascript"),
    "/explore.css": ("explore.css", "text/css"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
Route = tuple[str, type[tornado.web.RequestHandler], dict[str, tuple[str, str]]]
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def serve(
    started: Beginning,
    *,
    host: str = "127.0.0.1",
    port: int = 0,  # 0 takes any free one
    ready: Callable[[str], None],
    note: Callable[[str], None],
) -> None:
    """Serves the page until the process is interrupted."""

    async def run() -> None:
        sockets = tornado.netutil.bind_sockets(port, host)
        explorer = Explorer(started, note)
        server = tornado.httpserver.HTTPServer(
            application(explorer, known_hosts(host)),
            max_body_size=1 << 16,
            max_header_size=1 << 14,
        )
        server.add_sockets(sockets)
        number = sockets[0].getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        ready(f"http://{shown}:{number}/")
        await explorer.warm()
        await asyncio.Event().wait()

    # A thread that searches in the background gives way sooner to one that answers a change.
    sys.setswitchinterval(5e-4)
    asyncio.run(run())


def known_hosts(host: str) -> frozenset[str]:
    """Names by which a browser may call this server; names of other sites are refused."""
    local = {"localhost", "127.0.0.1", "::1"}
    try:
        everywhere = ipaddress.ip_address(host).is_unspecified
    except ValueError:
        everywhere = False
    return frozenset({host, *local} | ({socket.gethostname(), "*"} if everywhere else set()))


def is_known(name: str | None, hosts: frozenset[str]) -> bool:
    """Whether a host name is allowed; any numeric address is if all addresses are served.

    This refuses a name that another site has pointed to this machine.
    """
    if not name:
        return False
    if name.lower() in hosts:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return "*" in hosts


def application(explorer: "Explorer", hosts: frozenset[str]) -> tornado.web.Application:
    """The page and its connections."""
    routes: list[Route] = [(path, _File, {"file": file}) for path, file in _PAGE.items()]
    return tornado.web.Application(
        [*routes, ("/tab", _Tab)],
        default_handler_class=_Missing,
        explorer=explorer,
        hosts=hosts,
        websocket_max_message_size=MOST_BYTES + 1024,
        log_function=lambda handler: None,
    )


class Explorer:
    """The state that all tabs share: the first scene, the sessions, and the threads."""

    def __init__(self, started: Beginning, note: Callable[[str], None]):
        self.started = started
        self.note = note
        self.tabs: set[_Tab] = set()
        self.sessions: dict[str, Session] = {}
        self.doing = "starting"
        self.is_warm = asyncio.Event()
        self.quick = ThreadPoolExecutor(1, "first")
        self.slow = ThreadPoolExecutor(1, "rest")

    async def session(self, key: str) -> tuple[str, Session]:
        """A session for a new tab and its key, a copy of the session of an earlier key.

        The earlier session remains while a tab is open that has its key, such as the one that a
        browser duplicated.
        """
        earlier = self.sessions.get(key)
        if earlier is None:
            session = Session(self.started)
        else:
            loop = asyncio.get_running_loop()
            session = await loop.run_in_executor(self.quick, earlier.copy)
            if all(tab.key != key for tab in self.tabs):
                self.sessions.pop(key, None)
        key = secrets.token_urlsafe()
        self.sessions[key] = session
        for oldest in list(self.sessions)[:-MOST_SESSIONS]:
            del self.sessions[oldest]
        return key, session

    async def warm(self) -> None:
        """Searches for the design of the first scene, and compiles programs for the sliders."""
        loop = asyncio.get_running_loop()
        self._say("designing for the scene, and compiling: some seconds at the first time")
        try:
            designed = partial(with_design, self.started, lambda step, value: None)
            self.started = await loop.run_in_executor(self.quick, designed)
            self.is_warm.set()
            self._say("compiling for changes")
            await loop.run_in_executor(self.quick, self._drawn)
            programs = Session(self.started).ahead(self.started.tables)
            # Step by step, so that a change in the meantime waits for one step only.
            while await loop.run_in_executor(self.quick, next, programs, self) is not self:
                pass
            self._say("")
            self.note("ready: moving a slider designs anew")
        finally:
            self.is_warm.set()

    def _drawn(self) -> None:
        """Compiles programs for a drawn profile."""
        drawn = [0.25 + 0.5 * (chip % 3) / 2 for chip in range(NUM_CHIPS)]
        asked = Request(kind="design", id=0, scene=self.started.tables, drawn=drawn)
        Session(self.started).first(asked)

    def _say(self, text: str) -> None:
        self.doing = text
        if text:
            self.note(text)
        for tab in tuple(self.tabs):
            tab.tell({"kind": "doing", "text": text})


class _File(tornado.web.RequestHandler):
    """A file of the page."""

    def initialize(self, file: tuple[str, str]) -> None:
        self.name, self.kind = file

    def set_default_headers(self) -> None:
        _protect(self)

    def prepare(self) -> None:
        _refuse_others(self)

    def get(self) -> None:
        self.set_header("Content-Type", f"{self.kind}; charset=utf-8")
        self.finish((resources.files("mishutter.explore") / "page" / self.name).read_bytes())


class _Missing(tornado.web.RequestHandler):
    """Any other path."""

    def set_default_headers(self) -> None:
        _protect(self)

    def prepare(self) -> None:
        _refuse_others(self)
        raise tornado.web.HTTPError(404)


def _protect(handler: tornado.web.RequestHandler) -> None:
    for name, value in _HEADERS.items():
        handler.set_header(name, value)


def _refuse_others(handler: tornado.web.RequestHandler) -> None:
    """Refuses a request that calls this server by another name, as another site's page would."""
    try:
        name = urlsplit(f"//{handler.request.host}").hostname
    except ValueError:
        name = None
    if not is_known(name, handler.settings["hosts"]):
        raise tornado.web.HTTPError(403)


class _Tab(tornado.websocket.WebSocketHandler):
    """The connection of one tab."""

    def prepare(self) -> None:
        _refuse_others(self)
        if not self.check_origin(self.request.headers.get("Origin", "")):
            raise tornado.web.HTTPError(403)

    def check_origin(self, origin: str) -> bool:
        """Whether a connection comes from this page; Tornado calls this once more."""
        return origin.lower() == f"{self.request.protocol}://{self.request.host}".lower()

    async def open(self, *args: str, **kwargs: str) -> None:
        explorer: Explorer = self.settings["explorer"]
        self.key = ""
        self._latest: Request | None = None
        self._file = "photograph"
        self._asked = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        if len(explorer.tabs) >= MOST_TABS:
            await self._send({"kind": "closed", "text": f"at most {MOST_TABS} tabs at a time"})
            self.close()
            return
        explorer.tabs.add(self)
        self.key, self.session = await explorer.session(self.get_query_argument("key", ""))
        await self._send(
            {
                "kind": "hello",
                "fields": page_fields(),
                "scene": explorer.started.tables,
                "speed": explorer.started.speed,
                "key": self.key,
                "photographs": self.session.photographs,
                "pins": self.session.pins,
                "most": {"chips": NUM_CHIPS, "pins": MOST_PINS, "rows": MOST_ROWS},
                "doing": explorer.doing,
            }
        )
        self._task = asyncio.create_task(self._follow())

    def on_close(self) -> None:
        self.settings["explorer"].tabs.discard(self)
        if task := getattr(self, "_task", None):
            task.cancel()

    async def on_message(self, message: str | bytes) -> None:
        try:
            if isinstance(message, bytes):
                await self._compute(lambda: self.session.upload(self._file, message))
            else:
                await self._take(message)
        except ValueError as error:
            await self._send({"kind": "error", "text": _one_line(error)})
        except Exception as error:  # a bug: the page goes on, and the terminal shows the error
            logging.getLogger("mishutter").exception("a message of the page")
            await self._send({"kind": "error", "text": f"failed: {type(error).__name__}"})

    async def _take(self, message: str) -> None:
        if len(message) > _MOST_MESSAGE:
            raise ValueError(f"`a message` must hold at most {_MOST_MESSAGE} letters; got more.")
        try:
            content = json.loads(message)
        except (ValueError, RecursionError):
            raise ValueError("`a message` must be JSON; got something else.") from None
        if isinstance(content, dict) and content.get("kind") == "design":
            self._latest = validated(Request, content, "the request")
            self._asked.set()
            return
        order = validated(Order, content, "the message")
        if order.kind == "upload":
            self._file = order.name
            return
        await self._compute(lambda: self.session.answer(order))

    async def _compute(self, function: Callable[[], Answer]) -> None:
        explorer: Explorer = self.settings["explorer"]
        loop = asyncio.get_running_loop()
        await self._send(await loop.run_in_executor(explorer.quick, function))

    async def _follow(self) -> None:
        """Answers the latest request, over and over; a newer one supersedes an older one."""
        explorer: Explorer = self.settings["explorer"]
        loop = asyncio.get_running_loop()
        await explorer.is_warm.wait()
        if explorer.started.design is not None:
            self.session.begin(explorer.started.design)
        while True:
            await self._asked.wait()
            self._asked.clear()
            request = self._latest
            if request is None:
                continue
            is_answered = await self._guarded(
                request, loop.run_in_executor(explorer.quick, self.session.first, request)
            )
            if is_answered and not await self._is_asked_soon():
                await self._finish(explorer, request)

    async def _finish(self, explorer: Explorer, request: Request) -> None:
        """Sends the further answers, one by one, until a newer request comes."""
        loop = asyncio.get_running_loop()

        def check() -> None:
            if self._asked.is_set() or self.ws_connection is None:
                raise SupersededError

        self.tell({"kind": "doing", "text": "searching"})
        parts = self.session.rest(request, check)
        while not self._asked.is_set():
            part = loop.run_in_executor(explorer.slow, next, parts, None)
            if not await self._guarded(request, part):
                return

    async def _guarded(self, request: Request, part: "asyncio.Future[Answer | None]") -> bool:
        """Sends an answer, or one line on its error; returns whether there was an answer."""
        try:
            answer = await part
        except SupersededError:
            return False
        except Exception as error:
            is_bug = not isinstance(error, ValueError | RuntimeError)
            if is_bug:
                logging.getLogger("mishutter").exception("an answer of the page")
            await self._send({"kind": "error", "id": request.id, "text": _one_line(error)})
            return False
        if answer is None:
            return False
        await self._send(answer | {"id": request.id})
        return True

    async def _is_asked_soon(self) -> bool:
        """Whether a change comes before the hand counts as at rest."""
        try:
            await asyncio.wait_for(self._asked.wait(), 0.35)
        except TimeoutError:
            return False
        return True

    def tell(self, message: Answer) -> None:
        """Sends a message without waiting for its delivery; for short and rare ones."""
        if self.ws_connection is not None:
            self.write_message(json.dumps(message))

    async def _send(self, message: Answer) -> None:
        """Sends a message and waits for it, so that none pile up for a tab that sleeps."""
        try:
            await self.write_message(json.dumps(_plain(message), separators=(",", ":")))
        except tornado.websocket.WebSocketClosedError:
            raise asyncio.CancelledError from None


def _plain(value: object) -> object:
    """Replaces infinities and NaN, which JSON lacks, by None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _one_line(error: BaseException) -> str:
    return " ".join(own_message(error).split())[:500] or type(error).__name__
