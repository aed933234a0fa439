"""Entry point of ``mic``: how a command ends. What the commands are, :mod:`mic.options` says.

Nothing slow is imported here before the signals have their answer: whoever stops the program while it starts up is told
so in one line too.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import traceback
from typing import NoReturn

from mic.errors import MicError, Stopped

__all__ = ["main"]

AGAIN = 0.01  # s after which a stop that was lost is raised again
GARBAGE = 20_000  # objects that are new, after which it is looked for; Python's own is 700


def main() -> NoReturn:
    """One clear line for what a user can mend, a traceback for what only we can."""
    _on_signals(_leave_at_once)
    gc.set_threshold(GARBAGE, *gc.get_threshold()[1:])  # modules stay: to search them was a tenth of a short command
    from mic import options  # slow to import, and stopped as any other moment is
    from mic.execution.ranks import communicator, leave, others_silent
    from mic.system.console import sentence

    logging.basicConfig(format="%(message)s")  # such as what the cache does not believe: the sentence alone
    world, status, words = None, 0, ""
    try:
        _on_signals(_stop)
        world = communicator()
        with others_silent(world):
            options.app()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except MicError as error:
        status, words = 2, sentence(error)
    except Stopped as stop:
        status, words = stop.status, sentence("interrupted, and nothing was lost; call again")
    except OSError as problem:
        reason = (problem.strerror or str(problem)).lower()
        remedy = "make room or give permission (HOME must name a folder that can be written), and call again"
        status = 2
        words = sentence(f"{problem.filename or 'a file'}: {reason}; what is finished stays: {remedy}")
    except Exception:
        status, words = 1, traceback.format_exc()
    _on_signals(signal.SIG_DFL)  # nothing is left to be kept or said: whoever waits for the others just ends
    leave(world, status, words)


def _on_signals(answer) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, answer)


def _leave_at_once(number, frame):
    print("interrupted before anything was begun; call again", file=sys.stderr, flush=True)
    os._exit(128 + number)


def _stop(number, frame):
    """Raise in whatever the program is doing, and again a moment later where what is raised is lost.

    A callback from C (such as a compiler's, which works for seconds) and a destructor print it, with a traceback, and
    the program goes on.
    """

    def lost(unraisable):
        if not isinstance(unraisable.exc_value, Stopped):
            sys.__unraisablehook__(unraisable)
            return
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
        signal.setitimer(signal.ITIMER_REAL, AGAIN)

    sys.unraisablehook = lost
    raise Stopped(number)


if __name__ == "__main__":
    main()
