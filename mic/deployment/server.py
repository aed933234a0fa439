"""Runs the web server of a service: port, token, bounds on connections, signals."""

from __future__ import annotations

import asyncio
import logging
import os
import secrets
from contextlib import suppress
from pathlib import Path
from typing import Any

import uvicorn

from mic.deployment.application import application
from mic.deployment.service import Service
from mic.errors import FormatError, StorageError

__all__ = ["read_token", "serve"]

CONNECTIONS = 500  # open connections; further ones get status 503
IDLE = 20.0  # s after which a connection without a complete request is closed
GRACE = 30  # s in which requests are answered after the service was told to stop
SHORTEST = 16  # characters of a token


def serve(service: Service, token: str, host: str, port: int, seconds: float) -> None:
    """Serve until SIGINT or SIGTERM, which let requests end.

    Parameters
    ----------
    service : Service
    token : str
        From :func:`read_token`.
    host : str
        Address to listen on.
    port : int
        From :func:`mic.system.port.check_port`.
    seconds : float
        Time in which an answer is waited for, s.
    """
    for name in ("asyncio", "uvicorn"):  # they print what clients do wrong
        logging.getLogger(name).setLevel(logging.CRITICAL)
    config = uvicorn.Config(
        application(service, token, seconds),
        host,
        port,
        loop="asyncio",
        http="h11",
        ws="none",
        lifespan="on",
        log_config=None,
        access_log=False,
        server_header=False,
        limit_concurrency=CONNECTIONS,
        timeout_keep_alive=int(IDLE),
        timeout_graceful_shutdown=GRACE,
    )
    asyncio.run(_serve(uvicorn.Server(config)))


async def _serve(server: uvicorn.Server) -> None:
    idle = asyncio.create_task(_close_idle(server))
    try:
        await server.serve()
    finally:
        idle.cancel()


async def _close_idle(server: uvicorn.Server) -> None:
    """Close connections that send no complete request; uvicorn itself waits for a header without end."""
    older: dict[Any, Any] = {}
    while True:
        await asyncio.sleep(IDLE / 2)
        every: set[Any] = set(server.server_state.connections)
        current = {
            connection: connection.cycle
            for connection in every
            if connection.cycle is None or connection.cycle.response_complete
        }
        for connection, cycle in current.items():
            if connection in older and older[connection] is cycle:
                connection.transport.abort()
        older = current


def read_token(path: Path) -> str:
    """The token in a file, which is created with a random token, readable by its owner only, if there is none.

    Raises
    ------
    FormatError
        If the file holds no token of at least 16 printable characters.
    StorageError
        If it can be neither read nor created.
    """
    try:
        with suppress(FileExistsError):
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(descriptor, "w", encoding="ascii") as file:
                file.write(secrets.token_urlsafe(32) + "\n")
        with open(path, "rb") as file:
            token = file.read(1000).decode("ascii").strip()
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        raise StorageError(f"--token {path}: {reason}; give permission, or another file") from problem
    except ValueError:
        token = ""
    if len(token) < SHORTEST or not token.isprintable() or " " in token:
        raise FormatError(
            f"--token {path}: holds no token of at least {SHORTEST} characters without spaces; remove the file for a "
            "new one"
        )
    return token
