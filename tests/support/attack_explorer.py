"""Hostile clients of the page of ``mic explore``: requests, web sockets and messages that the page itself never sends.

The client is written on plain sockets, so that it can send what no library would.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import socket
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from support.springs import dragged

with contextlib.suppress(ImportError):  # wslink brings it
    import msgpack

__all__ = ["ATTACKS", "Served", "Socket", "attack", "bombard"]

PATIENCE = 10.0  # s for any answer
GROWTH = 200e6  # bytes by which the memory of the server may grow
ROUND = 12  # attacks of a round of :func:`attack`
# As on a machine without finite elements.
WITHOUT = "import sys; sys.modules.update(dolfinx=None, fem_reference=None); from mic.cli import main; main()"
#: Variables that only the server may change.
FIXED = ("title", "law", "controls", "groups", "stages", "characteristics", "interactor", "note")

NUMBERS = (0, 1, -1, 1e300, -1e300, 1e-300, float("nan"), float("inf"), -float("inf"), 2**63, -(2**63))
TEXTS = ("", "1", "x" * 5000, "<script>alert(1)</script>", "__class__")
OTHERS = (*TEXTS, None, True, [], {}, [[]], {"a": 1}, b"\x00\xff")
METHODS = ("GET", "POST", "HEAD", "OPTIONS", "PUT", "DELETE", "TRACE", "CONNECT", "get", "G\x01T", "")
PATHS = (
    *("/", "/index.html", "/ws", "/ws/", "//ws", "/%77s", "*", "", "http://a/", "/ws?token", "/\\..\\", "/paraview/"),
    *("/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%2f..%2fetc%2fpasswd", "/assets/../../../../etc/passwd"),
    *("/%00", "/%ff%fe", "/index.html%00.js", "/" + "a" * 300, "/" + "a/" * 3000, "/assets", "/vue.global.js?v=%ff"),
    *("/index.html?token=%ff%00", "/index.html?token=\xe9", "/?token=" + "x" * 7000),
)
CALLS = (
    *("trame.state.update", "trame.state.get", "trame.trigger", "trame.force.push", "trame.lifecycle.update"),
    *("trame.error.client", "application.exit", "application.exit.later", "wslink.hello", "unsubscribe", "absent"),
)
KEYS = (
    *("entries", "magnification", "stage", "characteristic", "all", "lows", "highs", "controls", "rows", "saved"),
    *(
        "title",
        "trame__template_main",
        "trame__scripts",
        "__class__",
        "_pushed_state",
        "absent",
        "",
        "bars",
        "answered",
    ),
)
NAMES = ("pick", "reset", "save_scene", "save_sample", "reset_view", "close", "set", "values", "__init__", "absent", "")


class Served:
    """``mic explore FILE`` in a process of its own, with all that it prints."""

    def __init__(self, model: Path, *options: str):
        self.folder = model.parent
        self.errors = self.folder / "explorer-errors.txt"
        with self.errors.open("w") as errors:
            self.program = subprocess.Popen(
                [sys.executable, "-c", WITHOUT, "explore", str(model), "--no-browser", *options],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                cwd=self.folder,
                env=os.environ | {"COLUMNS": "300"},
            )
        lines = []
        for line in self.program.stdout:
            lines.append(line)
            if "http://" in line:
                break
        else:
            raise AssertionError("".join(lines) + self.errors.read_text())
        self.address = lines[-1].split()[-1]
        self.host, _, query = self.address.removeprefix("http://").partition("/")
        self.path, self.port = f"/{query}", int(self.host.partition(":")[2])
        self.token = query.partition("token=")[2]
        self.program.stdout.readline()  # of who can open it, and how to stop

    def memory(self) -> int:
        """Bytes of the largest memory that the process had."""
        text = Path(f"/proc/{self.program.pid}/status").read_text()
        return 1024 * next(int(line.split()[1]) for line in text.splitlines() if line.startswith("VmHWM"))

    def stop(self) -> tuple[int, str, str]:
        """Exit code after Ctrl-C, and all that was printed after the address."""
        self.program.send_signal(signal.SIGINT)
        printed, _ = self.program.communicate(timeout=60)
        return self.program.returncode, printed, self.errors.read_text()

    def connect(self) -> socket.socket:
        """A connection without any request."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE)

    def exchange(self, request: bytes) -> tuple[int, str]:
        """Status and text of the answer to raw bytes; status 0 if the connection was closed without an answer."""
        found = b""
        with self.connect() as connection:
            with contextlib.suppress(ConnectionError):  # the server may answer before it has read all
                connection.sendall(request)
            with contextlib.suppress(ConnectionError):
                while piece := connection.recv(1 << 16):
                    found += piece
        head = found.partition(b"\r\n")[0].split()
        return (int(head[1]) if len(head) > 1 and head[0].startswith(b"HTTP/") else 0), found.decode(errors="replace")

    def request(self, path: str, method: str = "GET", body: bytes = b"", **headers: str) -> tuple[int, str]:
        """Status and text of the answer to a request."""
        lines = {"Host": self.host, "Connection": "close"} | headers
        text = f"{method} {path} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        return self.exchange(f"{text}\r\n".encode("latin-1", "replace") + body)


class Socket:
    """A web socket of the server; :attr:`status` is 101 if it is open."""

    def __init__(self, served: Served, path: str | None = None, hello: bool = True, **headers: str):
        self.connection, self._bytes, self._calls = served.connect(), b"", 0
        self._inflate = zlib.decompressobj(-15)
        upgrade = {"Host": served.host, "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        upgrade |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="} | headers
        text = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in upgrade.items())
        self.connection.sendall(f"GET {path or f'/ws?token={served.token}'} HTTP/1.1\r\n{text}\r\n".encode("latin-1"))
        while b"\r\n\r\n" not in self._bytes and (piece := self.connection.recv(1 << 16)):
            self._bytes += piece
        head, _, self._bytes = self._bytes.partition(b"\r\n\r\n")
        self.status = int(head.split()[1]) if head else 0
        if hello and self.status == 101:
            self.call("wslink.hello", {"secret": "wslink-secret"}, prefix="system")

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.connection.close()

    def frame(self, content: bytes, opcode: int = 2, flags: int = 0x80, claimed: int | None = None) -> None:
        """Send a frame of the protocol; `claimed` is a false length."""
        size = len(content) if claimed is None else claimed
        length = bytes([size | 0x80]) if size < 126 else b"\xff" + struct.pack(">Q", size)
        with contextlib.suppress(ConnectionError):
            self.connection.sendall(bytes([flags | opcode]) + length + b"\0\0\0\0" + content)

    def send(self, content: bytes, number: int = 1, offset: int = 0, claimed: int | None = None) -> None:
        """Send a message of wslink, or a piece of one."""
        size = len(content) if claimed is None else claimed
        self.frame(struct.pack("<III", number, offset, size) + content)

    def say(self, method: Any, *arguments: Any, prefix: str = "rpc") -> str:
        """Send a remote call, and return its key."""
        self._calls += 1
        key = f"{prefix}:x:{self._calls}"
        self.send(msgpack.packb({"wslink": "1.0", "id": key, "method": method, "args": list(arguments), "kwargs": {}}))
        return key

    def call(self, method: str, *arguments: Any, prefix: str = "rpc") -> Any:
        """The result of a remote call.

        Raises
        ------
        TimeoutError, ConnectionError
            If there is none.
        """
        key, end = self.say(method, *arguments, prefix=prefix), time.monotonic() + PATIENCE
        while time.monotonic() < end:
            message = self._message()
            if message.get("id") == key:
                return message.get("result", message.get("error"))
        raise TimeoutError

    def state(self) -> dict[str, Any]:
        """All variables of the page."""
        return self.call("trame.state.get")["state"]

    def _message(self) -> dict[str, Any]:
        opcode, content = self._frame()
        if opcode != 2:
            return {}
        size = struct.unpack("<I", content[8:12])[0]
        content = content[12:]
        while len(content) < size:
            content += self._frame()[1][12:]
        return msgpack.unpackb(content)

    def _frame(self) -> tuple[int, bytes]:
        first, size = self._take(2)
        if size >= 126:
            size = int.from_bytes(self._take(2 if size == 126 else 8), "big")
        content = self._take(size)
        if first & 0x40:
            content = self._inflate.decompress(content + b"\0\0\xff\xff")
        return first & 0x0F, content

    def _take(self, count: int) -> bytes:
        while len(self._bytes) < count:
            piece = self.connection.recv(1 << 20)
            if not piece:
                raise ConnectionError("closed")
            self._bytes += piece
        found, self._bytes = self._bytes[:count], self._bytes[count:]
        return found


def _any(rng: np.random.Generator, depth: int = 0) -> Any:
    """A random value of any type."""
    kind = rng.integers(4 if depth < 3 else 2)
    if kind == 0:
        return NUMBERS[rng.integers(len(NUMBERS))]
    if kind == 1:
        return OTHERS[rng.integers(len(OTHERS))]
    values = [_any(rng, depth + 1) for _ in range(rng.integers(4))]
    return values if kind == 2 else {str(i): value for i, value in enumerate(values)}


def _pick(rng: np.random.Generator, choices: tuple[Any, ...]) -> Any:
    return choices[rng.integers(len(choices))]


# Each attack returns its failures, one line each.


def odd_requests(rng: np.random.Generator, served: Served) -> list[str]:
    """Any method and path, with and without the token, with odd headers and bodies."""
    return [line for _ in range(20) for line in _odd_request(rng, served)]


def _odd_request(rng: np.random.Generator, served: Served) -> list[str]:
    headers: dict[str, str] = {}
    if rng.integers(2):
        headers["Cookie"] = f"mic-{served.port}={served.token}"
    odd = {"Host": "a.example", "Origin": "null", "X": "y" * 20000, "Content-Length": "-1", "Upgrade": "h2c"}
    odd |= {"Range": "bytes=9-1", "Cookie": f"mic-{served.port}=\xe9\xff", "Expect": "100-continue"}
    odd |= {"If-Modified-Since": "x", "Accept-Encoding": "\x00", "Content-Encoding": "gzip"}
    name = _pick(rng, (*odd, "Transfer-Encoding"))
    if rng.integers(2):
        headers[name] = odd.get(name, "chunked")
    end = b"0\r\n\r\n" * ("Transfer-Encoding" in headers)
    body = bytes(rng.integers(0, 256, int(_pick(rng, (0, 0, 10, 100_000))), dtype=np.uint8))
    if body and rng.integers(2):
        headers["Content-Length"] = str(len(body) + int(_pick(rng, (0, 0, -5))))
    method, path = _pick(rng, METHODS), _pick(rng, PATHS)
    status, text = served.request(path, method, body + end, **headers)
    allowed = headers.get("Cookie", "").endswith(served.token) and "a.example" not in headers.values()
    told = f"{method} {path[:60]} {sorted(headers)} gave {status}"
    wrong = [told] if status >= 500 or (status in range(200, 400) and not allowed) else []
    return wrong + [f"{told} and a file of the machine"] * ("root:x:0" in text)


def rubbish(rng: np.random.Generator, served: Served) -> list[str]:
    """Bytes that are no request, and connections closed in the middle."""
    with served.connect() as connection, contextlib.suppress(ConnectionError):
        starts = b"", b"GET ", b"GET /index.html HTTP/1.1\r\nHost: a\r\n", b"\x16\x03\x01", b"PRI * HTTP/2.0\r\n\r\n"
        connection.sendall(_pick(rng, starts) + bytes(rng.integers(0, 256, rng.integers(200_000), dtype=np.uint8)))
    return []


def many_connections(rng: np.random.Generator, served: Served) -> list[str]:
    """200 connections at a time, half of them with half a request, while another client asks."""
    with contextlib.ExitStack() as stack:
        for i in range(200):
            connection = stack.enter_context(served.connect())
            if i % 2:
                connection.sendall(b"GET /index.html HTTP/1.1\r\nHost: ")
        status = served.request(served.path)[0]
    return [] if status == 200 else [f"beside 200 open connections the page gave {status}"]


def many_sockets(rng: np.random.Generator, served: Served) -> list[str]:
    """Many web sockets at a time: the surplus is refused, and all is well afterwards."""
    with contextlib.ExitStack() as stack:
        found = [stack.enter_context(Socket(served, hello=bool(rng.integers(2)))).status for _ in range(40)]
    wrong = [f"40 web sockets: {sorted(set(found))}"] if found[0] != 101 or not set(found) <= {101, 503} else []
    return wrong + ["40 web sockets were all opened"] * (503 not in found)


def refused_sockets(rng: np.random.Generator, served: Served) -> list[str]:
    """Web sockets without the token, from other origins, to other hosts, and without an upgrade."""
    right, found = f"/ws?token={served.token}", []
    attempts: list[tuple[str, dict[str, str], tuple[int, ...]]] = [
        ("/ws", {}, (403,)),
        (right[:-1], {}, (403,)),
        (right, {"Origin": "http://a.example"}, (403,)),
        (right, {"Origin": f"http://127.0.0.1:{served.port + 1}"}, (403,)),
        (right, {"Host": f"a.example:{served.port}"}, (403,)),
        (right, {"Upgrade": "h2c"}, (400, 426)),
        (right, {"Connection": "close"}, (400, 426)),
        (right, {"Sec_WebSocket_Key": _pick(rng, ("", "x", "\xe9" * 24, "AAAA"))}, (400, 426)),
        (right, {"Sec_WebSocket_Version": "99"}, (400, 426)),
    ]
    for path, headers, wanted in attempts:
        with Socket(served, path, hello=False, **{key.replace("_", "-"): text for key, text in headers.items()}) as one:
            if one.status not in wanted:
                found.append(f"web socket {path[:4]} with {headers} gave {one.status}")
    status = served.request(right)[0]
    return found + [f"GET /ws without upgrade gave {status}"] * (status not in (400, 426))


def without_hello(rng: np.random.Generator, served: Served) -> list[str]:
    """Calls before the handshake of wslink, or after a wrong one, change nothing."""
    with Socket(served, hello=False) as one:
        if rng.integers(2):
            one.say("wslink.hello", {"secret": "wrong"}, prefix="system")
        one.say("trame.state.update", [{"key": "magnification", "value": 123456.5}])
        one.say("trame.trigger", "save_sample", [], {})
        time.sleep(0.2)
    with Socket(served) as other:
        changed = other.state()["magnification"] == 123456.5
    return ["a state was changed before the handshake"] * changed


def odd_calls(rng: np.random.Generator, served: Served) -> list[str]:
    """200 calls with methods, variables and values that the page does not send."""
    with Socket(served) as one:
        count = len(one.state()["entries"])
        for _ in range(200):
            kind = rng.integers(4)
            if kind == 0:
                one.say(_pick(rng, (*CALLS, None, 3, b"x")), *(_any(rng) for _ in range(rng.integers(4))))
            elif kind == 1:
                one.say("trame.state.update", [{"key": _pick(rng, KEYS), "value": _any(rng)}])
            elif kind == 2:
                entries = [float(x) for x in rng.normal(0, 10.0 ** rng.integers(-3, 4), count)]
                entries[rng.integers(count)] = _any(rng) if rng.integers(2) else _pick(rng, NUMBERS)
                value = entries[: rng.integers(count - 1, count + 1)]
                one.say("trame.state.update", [{"key": "entries", "value": value}])
            else:
                one.say("trame.trigger", _pick(rng, NAMES), [_any(rng) for _ in range(rng.integers(3))], _any(rng))
        one.state()  # the answer comes after all others
    return []


def odd_messages(rng: np.random.Generator, served: Served) -> list[str]:
    """Messages and frames that are malformed, too large or too deep."""
    hello = bool(rng.integers(2))
    with Socket(served, hello=hello) as one:
        kind = int(rng.integers(10))
        if kind == 0:
            one.send(bytes(rng.integers(0, 256, rng.integers(5000), dtype=np.uint8)))
        elif kind == 1:
            one.frame(bytes(rng.integers(0, 256, rng.integers(12), dtype=np.uint8)))
        elif kind == 2:  # a message of 4 GB, announced in many first pieces
            for i in range(100):
                one.send(b"x", number=i, claimed=int(_pick(rng, (500, 10**6, 2**32 - 1))))
        elif kind == 3:
            one.frame(b"x" * 100_000, opcode=2, claimed=int(_pick(rng, (10**6, 10**8, 2**62))))
        elif kind == 4:
            for _ in range(100):
                one.frame(b"\0" * 10**6, flags=0)  # 100 MB in fragments
        elif kind == 5:
            one.send(_pick(rng, (b"\x91", b"\xdd\x00\x0f\xff\xff", b"\x81\xa1a", b"\xdf\x00\x0f\xff\xff")) * 200_000)
        elif kind == 6:
            deep: Any = 0
            for _ in range(400):
                deep = [deep] if rng.integers(2) else {"args": deep}
            one.say("trame.state.update", [{"key": "entries", "value": deep}])
        elif kind == 7:
            one.frame(_pick(rng, (b"text", b"\xff\xfe", b"x" * 10**5)), opcode=1)
        elif kind == 8:
            opcode, flags = _pick(rng, (3, 8, 9, 10, 15)), _pick(rng, (0x80, 0xF0, 0))
            one.frame(b"\x03\xe8" + b"x" * 300, opcode, flags)
        else:
            content = msgpack.packb(_any(rng))
            one.send(content[: rng.integers(len(content) + 1)])
        time.sleep(0.05)
    return []


def compressed_bomb(rng: np.random.Generator, served: Served) -> list[str]:
    """A message of 100 kB that expands to 100 MB."""
    with Socket(served, Sec_WebSocket_Extensions="permessage-deflate") as one:
        squeeze = zlib.compressobj(wbits=-15)
        one.frame((squeeze.compress(bytes(10**8)) + squeeze.flush(zlib.Z_SYNC_FLUSH))[:-4], flags=0xC0)
        time.sleep(0.2)
    return []


def deaf_client(rng: np.random.Generator, served: Served) -> list[str]:
    """A client that asks and moves a slider without reading keeps nobody else waiting."""
    with Socket(served) as deaf, Socket(served) as other:
        deaf.connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connection.settimeout(0.5)
        entries = other.state()["entries"]
        with contextlib.suppress(TimeoutError):
            for i in range(3000):
                deaf.say("trame.state.get")
                deaf.say("trame.state.update", [{"key": "magnification", "value": float(i)}])
        start = time.monotonic()
        other.call("trame.state.update", [{"key": "entries", "value": entries}])
        took = time.monotonic() - start
    return [f"a client that reads nothing delayed another by {took:.0f} s"] * (took > PATIENCE)


def many_moves(rng: np.random.Generator, served: Served) -> list[str]:
    """200 positions of the sliders at a time: the last is what the page shows, soon."""
    with Socket(served) as one:
        state = one.state()
        lows, highs = np.array(state["lows"]), np.array(state["highs"])
        for _ in range(200):
            entries = (lows + (highs - lows) * rng.random(len(lows))).tolist()
            one.say("trame.state.update", [{"key": "entries", "value": entries}])
        start = time.monotonic()
        moved = one.state()
        while moved["preliminary"] or moved["answered"] == state["answered"]:
            time.sleep(0.02)
            moved = one.state()
            if time.monotonic() - start > PATIENCE:
                return ["200 moves were not answered"]
        done = moved["answered"] - state["answered"]
    wrong = [f"the page shows {moved['entries']} after {entries}"] if not np.allclose(moved["entries"], entries) else []
    return wrong + [f"200 moves led to {done} evaluations"] * (done > 200)


def abandoned(rng: np.random.Generator, served: Served) -> list[str]:
    """Clients that move a slider and leave at once, in the middle of a message, with a reset."""
    for _ in range(20):
        with Socket(served) as one:
            entries = one.state()["entries"] if rng.integers(2) else []
            one.say("trame.state.update", [{"key": "entries", "value": entries}])
            one.say("trame.state.get")
            one.frame(b"x" * 10, claimed=1000)
            if rng.integers(2):
                one.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    return []


ATTACKS: tuple[Callable[[np.random.Generator, Served], list[str]], ...] = (
    *(odd_requests, rubbish, many_connections, many_sockets, refused_sockets, without_hello, odd_calls, odd_messages),
    *(compressed_bomb, deaf_client, many_moves, abandoned),
)


def bombard(rng: np.random.Generator, served: Served, attacks: list[Callable]) -> list[str]:
    """Run attacks against a server and look whether it is as before: state, memory, speed, files."""
    with Socket(served) as one:
        before = one.state()
    memory, found = served.memory(), []
    for chosen in attacks:
        start = time.monotonic()
        try:
            found += chosen(rng, served)
            with Socket(served) as one:
                after = one.state()
                assert one.status == 101
        except (OSError, AssertionError, KeyError) as problem:
            after = f"after {time.monotonic() - start:.0f} s"
            found.append(f"{chosen.__name__}: {type(problem).__name__} {problem} {after}")
            time.sleep(1.0)
            continue
        found += [f"{chosen.__name__}: changed {key}" for key in FIXED if after[key] != before[key]]
        found += [f"{chosen.__name__}: new variables {sorted(new)}" for new in [after.keys() - before.keys()] if new]
        entries, same_length = np.array(after["entries"], dtype=float), len(after["entries"]) == len(before["entries"])
        if not same_length or not np.all((entries >= after["lows"]) & (entries <= after["highs"])):
            found.append(f"{chosen.__name__}: entries {after['entries']}")
        grown = served.memory() - memory
        if grown > GROWTH:
            found.append(f"{chosen.__name__}: the memory grew by {grown / 1e6:.0f} MB")
            memory += grown
        if served.program.poll() is not None:
            return [*found, f"{chosen.__name__}: the server ended"]
        printed = served.errors.read_text()
        if printed:
            found.append(f"{chosen.__name__}: printed {printed[-500:]!r}")
            served.errors.write_text("")
    return found


def attack(rng: np.random.Generator, folder: Path, count: int = ROUND) -> list[str]:
    """Failures of a round of random attacks against a server of a small model, one line each; none without trame."""
    if importlib.util.find_spec("trame_vtk") is None:
        return []
    dragged().save(folder / "model.npz")
    served = Served(folder / "model.npz")
    try:
        found = bombard(rng, served, [ATTACKS[i] for i in rng.integers(len(ATTACKS), size=count)])
    finally:
        code, printed, wrong = served.stop()
    found += [f"it ended with {code} and printed {printed!r}"] * (code != 0 or printed.strip() != "Stopped.")
    return found + [f"it printed {wrong[-500:]!r}"] * bool(wrong)
