"""Access control of the page: only the browser that opens the printed address, on this machine.

The address contains a random token. The first request with the token gets a cookie, which every further request must
send, including that of the web socket. A page of another site in the user's browser can send requests to this machine,
but does not know the token. DNS rebinding fails because such a request names another host.

The web socket passes only the remote calls that the page itself makes, with values that the page permits; every other
message is ignored. Message size, number of sockets and unsent data are bounded.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import secrets
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Protocol

import msgpack
from aiohttp import web

from mic.system.port import HOST

__all__ = ["LARGEST", "Guard", "GuardedPage"]

LARGEST = 1_000_000  #: bytes of the largest message that the web socket takes
LONGEST = 10_000  # entries of the longest list in a message
SOCKETS = 6  # open web sockets
BACKLOG = 16_000_000  # bytes that wait for a client; until then it delays no other client
STALLED = 2.0  # s without progress after which a client with a full backlog is disconnected
IDLE = 10.0  # s after which a connection without a request is closed
_HEADER = 12  # bytes before each message of wslink: number, offset and size, as it may come in pieces
_LIFE_CYCLE = ("client_connected", "client_unmounted", "client_exited")
# The page may not load anything from another host. Vue compiles its templates in the browser (unsafe-eval).
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
    "connect-src 'self' {socket} data: blob:; frame-ancestors 'none'"
)


class GuardedPage(Protocol):
    """Permissions of a page's clients."""

    def permitted_value(self, key: str, value: Any) -> Any:
        """The value that a variable of the page gets for a client's value; None if the client may not set it."""

    def permits_action(self, name: str, arguments: list[Any]) -> bool:
        """Whether a client may call an action with these arguments."""


class Guard:
    """Refuses requests without the token or from another host, and remote calls that the page does not make.

    Parameters
    ----------
    port : int
    page : GuardedPage

    Attributes
    ----------
    token : str
    """

    def __init__(self, port: int, page: GuardedPage):
        self._page, self._sockets = page, 0
        self.token = secrets.token_urlsafe(32)
        self._port, self._cookie = port, f"mic-{port}"  # browsers share cookies between the ports of a host
        self._hosts = {f"{name}:{port}" for name in (HOST, "localhost")}
        self._origins = {f"http://{host}" for host in self._hosts}

    @property
    def address(self) -> str:
        """Address of the page, with the token."""
        return f"http://{HOST}:{self._port}/index.html?token={self.token}"

    def _reason_to_refuse(self, request: web.Request) -> str | None:
        if request.headers.get("Host") not in self._hosts:
            return "the request names another host"
        if request.headers.get("Origin", next(iter(self._origins))) not in self._origins:
            return "the request comes from a page of another host"
        token = request.query.get("token") or request.cookies.get(self._cookie, "")
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the token is missing or wrong: open the address that mic explore printed"
        return None

    def protect(self, server: Any) -> None:
        """Put the guard between a server of wslink and its clients."""
        server.app.middlewares.append(self.middleware)
        for handler in server._ws_handlers:  # wslink has no public way to filter messages
            handler.onMessage = partial(self._receive, handler)
        for name in ("aiohttp", "asyncio", "trame_server", "wslink"):  # they print tracebacks for errors of clients
            logging.getLogger(name).addHandler(logging.NullHandler())
            logging.getLogger(name).propagate = False
        self._idle = asyncio.create_task(self._close_idle(server))

    async def _close_idle(self, server: Any) -> None:
        """Close connections that wait for a request, again and again; aiohttp itself would keep them. Web sockets and
        running requests stay."""
        older: set[Any] = set()
        while True:
            await asyncio.sleep(IDLE)
            current = set(server.runner.server.connections)
            for connection in older & current:
                connection.close()
            older = current

    @property
    def middleware(self) -> Callable[..., Awaitable[web.StreamResponse]]:
        """Middleware of the web application: status 403 for refused requests, cookie and policy for others."""

        @web.middleware
        async def check(request: web.Request, handler) -> web.StreamResponse:
            try:
                reason = self._reason_to_refuse(request)
                if reason:
                    return web.Response(status=403, text=f"refused: {reason}\n")
                response = await (self._open_socket(request, handler) if request.path == "/ws" else handler(request))
            except web.HTTPException:
                raise
            except Exception:  # no request may print a traceback on the terminal
                return web.Response(status=400, text="refused: the request is malformed\n")
            if not response.prepared:
                policy = {"Content-Security-Policy": _POLICY.format(socket=f"ws://{request.host}")}
                policy |= {"Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff"}
                response.headers.update(policy)
                response.set_cookie(self._cookie, self.token, httponly=True, samesite="Strict", path="/")
            return response

        return check

    async def _open_socket(self, request: web.Request, handler) -> web.StreamResponse:
        if not web.WebSocketResponse().can_prepare(request).ok:
            upgrade = {"Upgrade": "websocket", "Connection": "Upgrade"}
            return web.Response(status=426, text="refused: this address is a web socket\n", headers=upgrade)
        if self._sockets >= SOCKETS:
            return web.Response(status=503, text="refused: too many pages are open\n")
        assert request.transport is not None
        self._sockets += 1
        request.transport.set_write_buffer_limits(BACKLOG)
        watch = asyncio.create_task(_abort_when_stalled(request.transport))
        try:
            return await handler(request)
        finally:
            watch.cancel()
            self._sockets -= 1

    async def _receive(self, handler: Any, binary: bool, message: Any, client: str) -> None:
        """Pass a message on to wslink if it holds a permitted call."""
        call = self._permitted_call(message.data) if binary else None
        if call is not None:
            await handler.onCompleteMessage(call, client)

    def _permitted_call(self, message: bytes) -> dict[str, Any] | None:
        try:
            call = msgpack.unpackb(message[_HEADER:], max_array_len=LONGEST, max_map_len=LONGEST, max_ext_len=0)
        except Exception:  # msgpack raises errors of many types
            return None
        match call:
            case {"id": str(key), "method": str(method), "args": list(arguments)}:
                permitted = self._permitted_arguments(method, arguments)
                return None if permitted is None else {"id": key, "method": method, "args": permitted}
        return None

    def _permitted_arguments(self, method: str, arguments: list[Any]) -> list[Any] | None:
        match method, arguments:
            case ("wslink.hello", [{"secret": str()}]) | ("trame.state.get", []):
                return arguments
            case "trame.lifecycle.update", [str(name)] if name in _LIFE_CYCLE:
                return arguments
            case "trame.trigger", [str(name), list(values), *_] if self._page.permits_action(name, values):
                return [name, values, {}]
            case "trame.state.update", [list(changes)]:
                return [[change for change in map(self._permitted_change, changes) if change is not None]]
        return None

    def _permitted_change(self, change: Any) -> dict[str, Any] | None:
        match change:
            case {"key": str(key), "value": value}:
                permitted = self._page.permitted_value(key, value)
                return None if permitted is None else {"key": key, "value": permitted}
        return None


async def _abort_when_stalled(transport: asyncio.Transport) -> None:
    """Abort the connection of a client that reads nothing, because wslink waits for each client before the next."""
    unsent = 0
    while not transport.is_closing():
        await asyncio.sleep(STALLED)
        before, unsent = unsent, transport.get_write_buffer_size()
        if unsent >= BACKLOG and unsent == before:
            transport.abort()
