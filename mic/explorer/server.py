"""Runs the server of the page: port, guard, browser, Ctrl-C."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import webbrowser
from collections.abc import Callable

from mic.explorer.guard import Guard
from mic.explorer.page import Page
from mic.system.port import HOST

__all__ = ["serve"]


def serve(page: Page, port: int, browser: bool = True, ready: Callable[[str], None] = lambda address: None) -> None:
    """Serve a page to this machine only, until the program is interrupted.

    Parameters
    ----------
    page : Page
    port : int
        From :func:`mic.system.port.check_port`.
    browser : bool
        Whether to open the page in the user's browser.
    ready : callable
        Called with the address when the page can be opened.
    """
    asyncio.run(_serve(page, Guard(port, page), port, browser, ready))


async def _serve(page: Page, guard: Guard, port: int, browser: bool, ready: Callable[[str], None]) -> None:
    interrupted, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, interrupted.set)
    # Override what trame would read from the command line and the environment: no other host.
    os.environ |= {"TRAME_ARGS": f"--server --host {HOST}", "WSLINK_READY_MSG": ""}
    page.server.controller.on_server_bind.add(guard.protect)

    def on_ready(**_) -> None:
        ready(guard.address)
        if browser:
            threading.Thread(target=webbrowser.open, args=(guard.address,), daemon=True).start()

    page.server.controller.on_server_ready.add(on_ready)
    server = page.server.start(
        port=port,
        host=HOST,
        exec_mode="task",
        thread=True,  # signals are handled above
        open_browser=False,
        show_connection_info=False,
        disable_logging=True,
        timeout=0,
    )
    answers, interrupt = asyncio.create_task(page.answer_changes()), asyncio.create_task(interrupted.wait())
    try:
        done, _ = await asyncio.wait({server, answers, interrupt}, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()  # raises the task's error, if any
    finally:
        page.close()
        answers.cancel()
        if not server.done():
            await page.server.stop()
