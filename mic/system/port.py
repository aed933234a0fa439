"""A free port to listen on."""

from __future__ import annotations

import errno
import socket

from mic.errors import RunError

__all__ = ["HOST", "check_port"]

HOST = "127.0.0.1"  #: address of this machine that no other machine reaches


def check_port(port: int, host: str = HOST) -> int:
    """The given port, or a free one for 0.

    Raises
    ------
    RunError
        If the port is in use or needs administrator rights, or the address is not one of this machine.
    """
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError):
        raise RunError(f"--host {host}: is no address of this machine; correct it, or omit --host") from None
    with socket.socket(family) as test:
        test.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            test.bind(address)
        except PermissionError:
            reason = "needs administrator rights; use one above 1023, or omit --port"
            raise RunError(f"--port {port}: this port {reason}") from None
        except OSError as problem:
            if problem.errno == errno.EADDRNOTAVAIL:
                raise RunError(f"--host {host}: is no address of this machine; correct it, or omit --host") from None
            raise RunError(f"--port {port}: this port is in use; use another, or omit --port for a free one") from None
        return int(test.getsockname()[1])
