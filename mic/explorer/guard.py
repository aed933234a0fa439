"""Access control of the page: only the browser that opens the printed address, on this machine.

The address contains a random token. The first request with the token gets a cookie, which every further request must
send, including that of the web socket. A page of another site in the user's browser can send requests to this machine,
but does not know the token. DNS rebinding fails because such a request names another host.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable

from aiohttp import web

__all__ = ["HOST", "Guard"]

HOST = "127.0.0.1"  #: the only address on which the server listens
# The page may not load anything from another host. Vue compiles its templates in the browser (unsafe-eval).
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
    "connect-src 'self' {socket} data: blob:; frame-ancestors 'none'"
)


class Guard:
    """Refuses requests without the token or from another host.

    Parameters
    ----------
    port : int

    Attributes
    ----------
    token : str
    """

    def __init__(self, port: int):
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

    @property
    def middleware(self) -> Callable[..., Awaitable[web.StreamResponse]]:
        """Middleware of the web application: status 403 for refused requests, cookie and policy for others."""

        @web.middleware
        async def check(request: web.Request, handler) -> web.StreamResponse:
            reason = self._reason_to_refuse(request)
            if reason:
                return web.Response(status=403, text=f"refused: {reason}\n")
            response = await handler(request)
            if not response.prepared:
                policy = {"Content-Security-Policy": _POLICY.format(socket=f"ws://{request.host}")}
                policy |= {"Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff"}
                response.headers.update(policy)
                response.set_cookie(self._cookie, self.token, httponly=True, samesite="Strict", path="/")
            return response

        return check
