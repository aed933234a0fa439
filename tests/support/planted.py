"""``mic``, with an error planted in one process or with none: ``python -m support.planted RANK WHAT ARGUMENTS …``.

Its pages have no pictures: to draw them takes as long as all else that a run of few samples does.
"""

import os
import signal
import sys

from mic import cli
from mic.errors import RunError
from mic.process.process import Process
from mic.results.run_folder import RunFolder
from support.runs import skip_pictures

evaluate = Process.evaluate


def second_block(action):
    """Do something instead of the second block that a process evaluates; single samples are evaluated before."""
    calls = []

    def broken(self, *arguments):
        calls.extend([0] * (len(arguments[0]) > 1))
        if len(calls) == 2:
            action()
        return evaluate(self, *arguments)

    Process.evaluate = broken


def fail(error):
    raise error


def refuse(*arguments):
    raise RunError("planted sentence")


PLANTS = {
    "nothing": lambda: None,
    "bug": lambda: second_block(lambda: fail(RuntimeError("planted bug"))),
    "interrupt": lambda: second_block(lambda: os.kill(os.getpid(), signal.SIGINT)),
    "death": lambda: second_block(lambda: os.kill(os.getpid(), signal.SIGKILL)),
    "folder": lambda: setattr(RunFolder, "write_record", refuse),
    "cache": lambda: os.environ.update(MIC_CACHE=os.environ["MIC_CACHE"] + "-of-another-machine"),
}

if __name__ == "__main__":
    rank, what = sys.argv[1], sys.argv[2]
    sys.argv[:] = ["mic", *sys.argv[3:]]
    own = os.environ.get("OMPI_COMM_WORLD_RANK") or os.environ.get("PMI_RANK", "0")  # Open MPI, MPICH
    if own == "0":  # the one that draws
        skip_pictures(setattr)
    if own == rank:
        PLANTS[what]()
    cli.main()
