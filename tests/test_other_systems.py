"""A run and a report work without the features of Linux that other systems lack."""

import os
import subprocess
import sys

import pytest

#: Names of ``os`` and ``signal``, modules and files that macOS or Windows do not have. What the standard library and
#: threadpoolctl themselves need on Linux (such as ``os.fork``) stays.
LACKING = """
import os, signal, sys

PROC = ("/proc/cpuinfo", "/proc/self/statm", f"/proc/{os.getpid()}/stat", "/proc/sys/kernel/random/boot_id")

def absent(*args, **kwargs):
    raise FileNotFoundError("this system has no /proc")

for name in ("sched_getaffinity", "pread", "pwrite", "O_NOFOLLOW", "O_NONBLOCK", "getuid", "geteuid"):
    delattr(os, name)
for name in ("SIGALRM", "setitimer", "SIGHUP"):
    delattr(signal, name)
sys.modules["resource"] = sys.modules["pwd"] = None
sys.addaudithook(lambda event, args: absent() if event == "open" and str(args[0]) in PROC else None)
"""
SESSION = """
import mic
from pathlib import Path
from support.runs import skip_pictures
from verification.scenes import with_stated_pairs

scene = with_stated_pairs(mic.load_scene(Path(sys.argv[1]) / "meshes" / "lap_joint"))
report = scene.report.model_copy(update={"laws": ["coulomb"], "fields": False})
carlo = scene.monte_carlo.model_copy(update={"samples": 2})
scene = scene.model_copy(update={"report": report, "monte_carlo": carlo})
mic.run(scene, Path("results"), mic.cache_folder())
skip_pictures(setattr)
mic.report.write_report("results")
"""


@pytest.mark.slow
def test_a_run_and_a_report_need_nothing_that_other_systems_lack(tmp_path, cache, request):
    environment = {**os.environ, "MIC_CACHE": str(cache)}
    command = [sys.executable, "-c", LACKING + SESSION, str(request.config.rootpath)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "report.html").is_file()
