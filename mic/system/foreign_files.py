"""The gate for files that the program did not write: meshes, decks, matrices, tables, scenes.

Each is read inside :func:`reading`. Its reader can open files of the scene's folder, and of folders that the user
names; whatever it raises becomes one sentence that names the file; its time and the size of the file are bounded.
Programs that convert files run in :mod:`mic.system.helper_program`.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import site
import stat
import sys
import sysconfig
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path

from mic.errors import FormatError, MicError, RunError

try:
    import resource
except ImportError:  # not a POSIX system
    resource = None  # type: ignore[assignment]

__all__ = [
    "ALSO_READ",
    "NO_SCRIPTS",
    "library_folders",
    "opened_file",
    "reading",
    "reason_to_refuse",
    "refuse_library_settings",
    "scripts_allowed",
    "temporary_folder",
]

ALSO_READ = "MIC_ALSO_READ"  #: environment variable: folders that scenes may read besides their own, as in PATH
NO_SCRIPTS = "MIC_NO_SCRIPTS"  #: environment variable: if it is set, geometry scripts are refused

LARGEST = 4_000_000_000  # bytes
MEMORY = 2_000_000_000  # bytes of address space that a reader may add
MEMORY_PER_BYTE = 100  # additional bytes per byte of the file
LIMIT = 60.0  # s that a reader may take; some libraries loop forever on damaged files
LIMIT_PER_MB = 30.0  # additional s per MB

#: Files by which a working folder configures libraries, all of which can then load code from any place.
SETTINGS = {
    ".petscrc": "PETSc",
    "petscrc": "PETSc",
    "petsc.cfg": "petsc4py",
    ".numba_config.yaml": "numba",
    "matplotlibrc": "matplotlib",
    "dolfinx_jit_options.json": "dolfinx",
    "dolfinx_jit_parameters.json": "dolfinx",
    "ffcx_options.json": "FFCx",
    "ffcx_parameters.json": "FFCx",
}

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND

_TEMPORARY = "mic-"  # prefix of the temporary folders of readers
_gate = threading.local()  # .folders, .others: folders whose files this thread may open inside `reading`
_hook_installed: list[bool] = []  # an audit hook cannot be removed


@contextmanager
def reading(
    path: Path, kind: str, folder: Path | None = None, error: type[MicError] = FormatError, seconds: float = 0.0
) -> Iterator[None]:
    """Read a file of the user in this context; whatever goes wrong there becomes one sentence.

    Parameters
    ----------
    path : Path
    kind : str
        For the messages, such as ``"mesh file"``.
    folder : Path, optional
        Folder of the scene that names the file: the file, and all that its reader opens, must lie in it, or in a folder
        of ``MIC_ALSO_READ``. Default: the user names the file; its reader opens files of its folder.
    error : type
        Class of the error.
    seconds : float
        Additional time for the reader.

    Raises
    ------
    MicError
        Of the class `error`, if the file does not exist, is no regular file, is too large or lies elsewhere, or if
        reading it raises anything or takes too long. Its message begins with the path.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise error(f"{path}: this {kind} does not exist; correct the name") from None
    except (OSError, ValueError) as problem:
        raise error(f"{path}: this {kind} cannot be read ({_describe(problem)}); correct the name") from None
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{path}: this {kind} is no file, but a folder, pipe or device; give a file")
    size = status.st_size
    if size > LARGEST:
        raise error(f"{path}: this {kind} has {size / 1e9:.3g} GB, more than {LARGEST / 1e9:g}; give a smaller one")
    seconds += LIMIT + LIMIT_PER_MB * size / 1e6
    try:
        folders = (path.parent, path.resolve().parent) if folder is None else (folder,)
        memory = MEMORY + MEMORY_PER_BYTE * size
        with _memory_limit(memory), _only_from(folders), _time_limit(seconds), _silence():
            if reason := reason_to_refuse(path):
                raise error(f"it {reason}")
            yield
            return
    except MicError as problem:
        raise error("\n".join(f"{path}: {line}" for line in str(problem).splitlines())) from problem
    except ImportError as problem:
        install = f"install it (pip install {problem.name}), or save the file in another format"
        raise error(f"{path}: reading {path.suffix} files needs the package {problem.name}; {install}") from problem
    except MemoryError:
        text = f"needs more than {memory / 1e9:.1f} GB of memory: it is damaged or not what its suffix says"
    except TimeoutError:
        text = f"was not read in {seconds:.0f} s: it is damaged or not what its suffix says"
    except PermissionError:
        raise error(f"{path}: this {kind} cannot be read; give permission") from None
    except (Exception, SystemExit) as problem:  # libraries raise any exception, some exit
        text = f"cannot be read: it is cut short, damaged or not what its suffix says ({_describe(problem)})"
    raise error(f"{path}: this {kind} {text}; correct it, or export it again in another format")


def reason_to_refuse(path: Path, folder: Path | None = None) -> str | None:
    """Why a file may not be read, and the remedy, as the end of a sentence; None if it may.

    Parameters
    ----------
    path : Path
    folder : Path, optional
        Folder of the scene. Default: those of the surrounding :func:`reading`; all files are allowed outside of one.
    """
    own = getattr(_gate, "folders", ()) if folder is None else (folder,)
    real = Path(os.path.realpath(path))
    named = [name for name in os.environ.get(ALSO_READ, "").split(os.pathsep) if name]
    if not own or any(real.is_relative_to(os.path.realpath(allowed)) for allowed in (*own, *named)):
        return None
    return (
        f"lies outside of the scene's folder {own[0]}; move it there, or allow its folder: --also-read "
        f"{shlex.quote(str(real.parent))}"
    )


def scripts_allowed() -> bool:
    """Whether geometry scripts may run."""
    return not os.environ.get(NO_SCRIPTS)


def refuse_library_settings(folder: Path) -> None:
    """Refuse a working folder that holds settings of libraries, by which a scene's sender could run programs.

    Raises
    ------
    RunError
        Unless the folder is the user's home.
    """
    if folder.resolve() == Path.home().resolve():
        return
    for name, library in SETTINGS.items():
        if os.path.lexists(folder / name):
            raise RunError(
                f"{folder / name}: {library} would read its settings from this file, which can make it load code; "
                "rename the file, or run mic in another folder"
            )


@cache
def library_folders() -> tuple[str, ...]:
    """Folders of Python, its packages and this program, each with a separator at its end."""
    places = {*sysconfig.get_paths().values(), sys.prefix, sys.base_prefix, str(Path(__file__).resolve().parents[2])}
    places.add(site.getusersitepackages())  # of pip install --user
    return tuple(os.path.join(os.path.realpath(place), "") for place in places if place)


def opened_file(event: str, arguments: tuple) -> tuple[str, bool] | None:
    """Path as given, and whether for writing, of an audit event that opens a file by its name; None for any other."""
    if event != "open":
        return None
    path, mode, flags = arguments
    if not isinstance(path, (str, bytes)):
        return None  # a descriptor of an open file
    writes = any(letter in mode for letter in "wax+") if isinstance(mode, str) else bool((flags or 0) & _WRITING)
    return os.fsdecode(path), writes


@contextmanager
def _only_from(folders: tuple[Path, ...]) -> Iterator[None]:
    """Refuse to open files outside of some folders, but those of libraries and temporary ones, in this thread."""
    if not _hook_installed:
        sys.addaudithook(_audit)
        _hook_installed.append(True)
    outer = getattr(_gate, "folders", ())
    # Found before the gate closes: finding the temporary folder opens a file there and holds a lock meanwhile.
    _gate.others = (*library_folders(), os.path.join(tempfile.gettempdir(), _TEMPORARY))
    _gate.folders = folders
    try:
        yield
    finally:
        _gate.folders = outer


def _audit(event: str, arguments: tuple) -> None:
    """Audit hook: refuse to open a file that :func:`reading` does not allow."""
    if not getattr(_gate, "folders", ()) or (opened := opened_file(event, arguments)) is None:
        return
    name, writes = opened
    if writes or name.startswith(_gate.others) or os.path.realpath(name).startswith(_gate.others):
        return
    if reason := reason_to_refuse(Path(name)):
        raise FormatError(f"it names {name}, which {reason}")


@contextmanager
def _silence() -> Iterator[None]:
    """Discard what libraries print and warn of: it may quote the file, control characters included."""
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """An empty folder, removed at the end, whose files a reader may open."""
    folder = tempfile.mkdtemp(prefix=_TEMPORARY)
    try:
        yield Path(folder)
    finally:
        with _only_from(()):  # removing opens folders by names that are relative to descriptors
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _memory_limit(more: int) -> Iterator[None]:
    """Raise MemoryError when the address space of this process grows by a number of bytes; only on Linux."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        old, most = resource.getrlimit(resource.RLIMIT_AS)
    except (OSError, AttributeError):  # another system
        yield
        return
    limits = [limit for limit in (old, most) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([pages * resource.getpagesize() + more, *limits]), most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (old, most))


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after a number of seconds; only in the main thread, where signals arrive."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def on_alarm(number, frame):
        raise TimeoutError

    previous = signal.signal(signal.SIGALRM, on_alarm)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def _describe(problem: BaseException) -> str:
    """Message of an exception on one line, with its type."""
    text = " ".join(str(problem).split())
    kind = "exit" if isinstance(problem, SystemExit) else type(problem).__name__
    return f"{kind}: {text}" if text else kind
