"""Who may see the page: the browser that was given its address, on this machine, and nobody else.

The address holds a random token. Whoever comes with it is given a cookie, which every further request must bring, that
of the socket included. A page of another site that the user happens to have open can send requests to this machine, but
knows no token; and where a name of its own leads here (DNS rebinding), the request names another host and is refused.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable

from aiohttp import web

__all__ = ["HOST", "Guard"]

HOST = "127.0.0.1"  #: the only address that is listened at
# Nothing is asked of another host, whatever the page says; its templates are compiled in the browser (unsafe-eval).
_POLICY = "; ".join(
    (
        "default-src 'self'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "font-src 'self' data:",
        "worker-src 'self' blob:",
        "connect-src 'self' {socket} data: blob:",
        "frame-ancestors 'none'",
    )
)


class Guard:
    """What each request must bring.

    Parameters
    ----------
    port : int

    Attributes
    ----------
    token : str
    """

    def __init__(self, port: int):
        self.token = secrets.token_urlsafe(32)
        self._port, self._cookie = port, f"mic-{port}"  # browsers do not tell the ports of a host apart
        self._hosts = {f"{name}:{port}" for name in (HOST, "localhost")}
        self._origins = {f"http://{host}" for host in self._hosts}

    @property
    def address(self) -> str:
        """What to open."""
        return f"http://{HOST}:{self._port}/index.html?token={self.token}"

    def refusal(self, request: web.Request) -> str | None:
        """Why a request is not answered; None where it is."""
        if request.headers.get("Host") not in self._hosts:
            return "another host is named"
        if request.headers.get("Origin", next(iter(self._origins))) not in self._origins:
            return "it comes from a page of another host"
        given = request.query.get("token") or request.cookies.get(self._cookie, "")
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            return "the token is missing or wrong: open the address that mic explore printed"
        return None

    @property
    def middleware(self) -> Callable[..., Awaitable[web.StreamResponse]]:
        """For the web application that is guarded."""

        @web.middleware
        async def guarded(request: web.Request, handler) -> web.StreamResponse:
            refused = self.refusal(request)
            if refused:
                return web.Response(status=403, text=f"refused: {refused}\n")
            response = await handler(request)
            if not response.prepared:
                response.headers["Content-Security-Policy"] = _POLICY.format(socket=f"ws://{request.host}")
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["X-Content-Type-Options"] = "nosniff"
                response.set_cookie(self._cookie, self.token, httponly=True, samesite="Strict", path="/")
            return response

        return guarded
