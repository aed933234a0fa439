"""Entry point of ``mic``: runs a command of :mod:`mic.options` and turns its outcome into an exit status and a message.

The signal handlers are installed before slow imports, so that an interrupt during start-up also ends in one line.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import traceback
from pathlib import Path
from typing import NoReturn

from mic.errors import MicError, RunError, Stopped

__all__ = ["main"]

RETRY = 0.01  # s after which a signal whose exception was lost is raised again
GARBAGE = 20_000  # new objects that trigger a garbage collection; Python's default is 700


def main() -> NoReturn:
    """Run the command; print one line for errors that a user can correct, a traceback for errors of the program."""
    _on_signals(_exit_at_once)
    gc.set_threshold(GARBAGE, *gc.get_threshold()[1:])  # a tenth of a short command's time
    from mic import options  # slow to import, so after the signal handlers
    from mic.execution.ranks import communicator, exit_together, silence_other_ranks
    from mic.system.console import error_line
    from mic.system.foreign_files import refuse_library_settings

    logging.basicConfig(format="%(message)s")  # warnings of the cache, for example
    world, status, message = None, 0, ""
    try:
        _on_signals(_raise_stopped)
        refuse_library_settings(Path.cwd())
        _refuse_undecodable(sys.argv)
        world = communicator()
        with silence_other_ranks(world):
            options.app()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except MicError as error:
        status, message = 2, error_line(error)
    except Stopped as stop:
        status, message = stop.status, error_line("interrupted; finished samples are saved, run the command again")
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        remedy = "free disk space or give permission (HOME must name a folder that can be written), and run again"
        status = 2
        message = error_line(f"{problem.filename or 'a file'}: {reason}; finished samples are saved: {remedy}")
    except Exception:
        status, message = 1, traceback.format_exc()
    _on_signals(signal.SIG_DFL)  # nothing is left to save or report
    exit_together(world, status, message)


def _refuse_undecodable(arguments) -> None:
    """Refuse file names that are no UTF-8: they can be neither printed nor written into a scene."""
    for text in arguments:
        try:
            text.encode()
        except UnicodeEncodeError:
            raise RunError(f"{ascii(text)}: this name is no valid UTF-8; rename the file") from None


def _on_signals(handler) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _exit_at_once(number, frame):
    print("interrupted during start-up; run the command again", file=sys.stderr, flush=True)
    os._exit(128 + number)


def _raise_stopped(number, frame):
    """Raise :class:`Stopped` in the running code, and again a moment later if that exception is lost.

    Callbacks from C (such as those of a compiler that works for seconds) and destructors only print an exception, and
    the program continues.
    """

    def on_unraisable(unraisable):
        if not isinstance(unraisable.exc_value, Stopped):
            sys.__unraisablehook__(unraisable)
            return
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
        signal.setitimer(signal.ITIMER_REAL, RETRY)

    sys.unraisablehook = on_unraisable
    raise Stopped(number)


if __name__ == "__main__":
    main()
