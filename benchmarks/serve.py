"""Rate and delay of ``mic serve`` on this machine.

    python benchmarks/serve.py                               # lap joint, two workers
    python benchmarks/serve.py --exact --rate 500 2000 --seconds 30

The service is a process of its own; each client opens a connection, sends the deviations of a random assembly of the
scene and waits for the answer, whatever others wait for. Delays are those of the client: connection, log on disk,
queue, evaluation. *most* is the rate with eight clients that each wait for an answer before the next request.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

import mic
from mic.statistics.draw import draw

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = ("requests a minute", "sent", "answered", "median, ms", "95 %, ms", "99 %, ms", "CPU a request, ms")
CLIENTS = 8
START = 300.0  # s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, default=ROOT / "meshes" / "lap_joint")
    parser.add_argument("--rate", type=float, nargs="+", default=[500.0, 1500.0], help="requests a minute")
    parser.add_argument("--seconds", type=float, default=20.0, help="at each rate")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--exact", action="store_true", help="evaluate every assembly")
    arguments = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        model = mic.reduce(mic.load_scene(arguments.scene))
        model.save(folder / "model.npz")
        count = int(max(arguments.rate) * arguments.seconds / 60)
        rows = [dict(zip(model.parameters, map(float, x))) for x in draw(model.scene, 1, 0, count)]
        process, port = started(folder, arguments)
        try:
            table = Table(*COLUMNS)
            token = (folder / "serve.token").read_text().strip()
            for rate in (*arguments.rate, None):
                table.add_row(*asyncio.run(measured(port, token, rows, rate, arguments.seconds, process.pid)))
            Console(width=150).print(table)
        finally:
            process.terminate()
            process.wait()


def started(folder: Path, arguments) -> tuple[subprocess.Popen, int]:
    """The service and its port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "mic", "serve", "model.npz", "--port", str(port)]
    command += ["--engine", f"local:{arguments.workers}", *(["--exact"] if arguments.exact else [])]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    until = time.monotonic() + START
    while time.monotonic() < until and process.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            return process, port
        except OSError:
            time.sleep(0.1)
    raise SystemExit("the service has not started")


async def measured(port: int, token: str, rows: list, rate: float | None, seconds: float, process: int) -> list[str]:
    """The row of one rate, or of the largest one."""
    delays: list[float] = []
    codes: list[int] = []
    begun, used = time.perf_counter(), cpu(process)

    async def request(row) -> None:
        start = time.perf_counter()
        codes.append(await answered(port, token, row))
        delays.append(time.perf_counter() - start)

    if rate is None:

        async def client(first: int) -> None:
            for row in rows[first::CLIENTS]:
                if time.perf_counter() - begun < seconds:
                    await request(row)

        await asyncio.gather(*(client(first) for first in range(CLIENTS)))
    else:
        tasks = []
        for i in range(int(rate * seconds / 60)):
            await asyncio.sleep(max(0.0, begun + 60 * i / rate - time.perf_counter()))
            tasks.append(asyncio.create_task(request(rows[i])))
        await asyncio.gather(*tasks)
    reached = 60 * len(delays) / (time.perf_counter() - begun)
    own = 1e3 * (cpu(process) - used) / len(delays)
    times = [f"{1e3 * value:.1f}" for value in np.quantile(delays, (0.5, 0.95, 0.99))]
    label = f"{reached:.0f}" if rate else f"{reached:.0f} (most)"
    return [label, str(len(delays)), str(codes.count(200)), *times, f"{own:.1f}"]


async def answered(port: int, token: str, row: dict) -> int:
    """Status of the answer."""
    body = json.dumps({"deviations": row}).encode()
    head = f"POST /assemblies HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: Bearer {token}\r\n"
    head += f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
    try:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(head.encode() + body)
        answer = await reader.read()
        writer.close()
        return int(answer.split()[1])
    except (OSError, IndexError, ValueError):
        return 0


def cpu(process: int) -> float:
    """Processor time of a process and its children that run, s."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    for task in Path(f"/proc/{process}/task").iterdir():
        children += (task / "children").read_text().split() if task.name != str(process) else []
    total = 0.0
    for one in (str(process), *children):
        fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
        total += (int(fields[11]) + int(fields[12])) / 100
    return total


if __name__ == "__main__":
    main()
