"""From the start of the page to its end: the port, the guard, the browser, Ctrl-C."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
import webbrowser
from collections.abc import Callable

from mic.errors import RunError
from mic.explorer.guard import HOST, Guard
from mic.explorer.page import Page

__all__ = ["free", "serve"]


def serve(page: Page, port: int, browser: bool = True, ready: Callable[[str], None] = lambda address: None) -> None:
    """Serve a page on this machine alone until the program is interrupted.

    Parameters
    ----------
    page : Page
    port : int
        As :func:`free` gives it.
    browser : bool
        Whether the user's browser is opened.
    ready : callable
        Called with the address once it can be opened.
    """
    asyncio.run(_served(page, Guard(port), port, browser, ready))


def free(port: int) -> int:
    """A port that may be listened at: the one asked for; for 0 any.

    Raises
    ------
    RunError
        If it is taken, or not to be had.
    """
    with socket.socket() as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            one.bind((HOST, port))
        except PermissionError:
            raise RunError(
                f"--port {port}: it takes an administrator; name one above 1023, or leave --port out"
            ) from None
        except OSError:
            raise RunError(f"--port {port}: it is in use; name another, or leave --port out for any free one") from None
        return int(one.getsockname()[1])


async def _served(page: Page, guard: Guard, port: int, browser: bool, ready: Callable[[str], None]) -> None:
    ended, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    # What trame would read from the command line and the environment is settled here: no other host.
    os.environ |= {"TRAME_ARGS": f"--server --host {HOST}", "WSLINK_READY_MSG": ""}
    page.server.controller.on_server_bind.add(lambda server: server.app.middlewares.append(guard.middleware))

    def opened(**_) -> None:
        ready(guard.address)
        if browser:
            threading.Thread(target=webbrowser.open, args=(guard.address,), daemon=True).start()

    page.server.controller.on_server_ready.add(opened)
    serving = page.server.start(
        port=port,
        host=HOST,
        exec_mode="task",
        thread=True,  # signals are answered above
        open_browser=False,
        show_connection_info=False,
        disable_logging=True,
        timeout=0,
    )
    answering, waiting = asyncio.create_task(page.answer_moves()), asyncio.create_task(ended.wait())
    try:
        done, _ = await asyncio.wait({serving, answering, waiting}, return_when=asyncio.FIRST_COMPLETED)
        for one in done:
            one.result()  # an error of the page's own is not swallowed
    finally:
        page.close()
        answering.cancel()
        if not serving.done():
            await page.server.stop()
