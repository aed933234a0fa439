"""Damaged and hostile files of a user, in every format that the program reads.

``python -m support.attack_foreign_files SEED COUNT`` prints the failures of COUNT files in this process, whose address
space it limits.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import meshlane
import numpy as np
import pandas as pd

from mic.compliance.matrices import read_matrix
from mic.errors import MicError
from mic.geometry.measured_points import read_clouds
from mic.geometry.readers import gmsh_program, read_mesh
from mic.geometry.surface import Surface
from mic.scene import load_scene
from mic.scene.measured_report import read_measured_report
from mic.scene.measurement import Measurement
from mic.scene.samples import take_samples
from mic.scene.table_rows import read_rows
from support.gmsh_files import gmsh_model
from support.mesh_texts import FILES, POINTS
from support.workbooks import workbook

__all__ = ["READERS_OF", "attack", "damaged", "originals", "trouble"]

FAILURE = "failure: "  # before the lines that count; gmsh prints others
LONGEST = 20.0  # s that a small file may take
MEMORY = 6_000_000_000  # bytes of address space
COUNT = 150  # files of a round
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]])
MATRIX = "%%MatrixMarket matrix coordinate real symmetric\n6 6 6\n" + "".join(f"{i} {i} 2.5\n" for i in range(1, 7))
NODES = "node,x,y,z\n1,0,0,0\n2,1,0,0\n"
ENTRIES = "".join(f"{node},{k},{node},{k}, 2.5\n" for node in (1, 2) for k in (1, 2, 3))
TABLE = "name,part,x,y,z\nA,lower,1.0,2.0,0.0\nB,upper,3.0,4.0,0.5\n"
QDAS = "K0100 2\nK1001/1 4711\nK2002/1 M1\nK2101/1 0.0\nK2142/1 mm\nK2002/2 M2\nK2112/2 -1\nK2142/2 um\nK2022/0 3\n"
SCENE = Path(__file__).resolve().parents[2] / "meshes" / "lap_joint"
#: Texts that are put into files: numbers beyond all bounds, nesting, other encodings, commands of decks.
TEXTS = (
    *(b"nan", b"inf", b"-1", b"0", b"1e400", b"99999999999999999999", b"2147483648", b"500000000000"),
    *(b"-9223372036854775809", b"[" * 3000, b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n\n\n", b"\x1b[2J"),
    *(b",", b"*", b"$", b"'", b'"', b"%", b"=", b"\\", b"&lol;", b"<!--"),
    *(b"*INCLUDE, INPUT=/etc/passwd\n", b"INCLUDE '/etc/passwd'\n", b"*INCLUDE\n../../etc/passwd\n"),
)
BINARY = ("msh", "ply", "stl", "vtk", "vtu")  # formats that are written as text and binary


def _rows(path: Path) -> None:
    read_rows(path, Measurement)


def _cloud(path: Path) -> None:
    for cloud in read_clouds(path, "mm", Surface(POINTS, TRIANGLES), None).values():
        assert np.isfinite(cloud.points).all()


def _report(path: Path) -> None:
    report = read_measured_report(path, ["M1", "M2"], "key characteristic", {"M1": (0.0, 0.6, 0.8)})
    assert all(np.isfinite(value) for own in report.values.values() for value in own.values())


def _matrix(path: Path) -> None:
    assert np.isfinite(read_matrix(path).matrix.data).all()


def _mesh(path: Path, size: float | None = None) -> None:
    surface, _ = read_mesh(path, size=size)
    assert np.isfinite(surface.points).all() and surface.triangles.max() < len(surface.points)


def _samples(path: Path) -> None:
    scene = load_scene(SCENE)
    asked = type(scene.monte_carlo)(table=path.name)
    take_samples(scene.model_copy(update={"monte_carlo": asked, "folder": path.parent}))


def _scene(path: Path) -> None:
    load_scene(path)


#: The reader of each kind of file, by the beginning of its name.
READERS_OF: dict[str, Callable[[Path], None]] = {
    "gmsh": lambda path: _mesh(path, 5.0),
    "mesh": _mesh,
    "table": _rows,
    "cloud": _cloud,
    "report": _report,
    "matrix": _matrix,
    "samples": _samples,
    "scene": _scene,
}


def originals() -> dict[str, bytes]:
    """Content of a valid file of each kind and format, by name."""
    contents = {f"mesh-{name}": text.encode() for name, text in FILES.items()}
    with TemporaryDirectory() as name:
        folder = Path(name)
        sheet = meshlane.Mesh(POINTS, [("triangle", TRIANGLES)])
        for suffix in ("cdb", "meshb", *BINARY, *BINARY):
            options = {"binary": f"mesh-a.{suffix}" in contents} if suffix in BINARY else {}
            path = folder / f"{'b' if options.get('binary') else 'a'}.{suffix}"
            meshlane.write(path, sheet, *(["gmsh"] if suffix == "msh" else []), **options)
            contents[f"mesh-{path.name}"] = path.read_bytes()
        rng = np.random.default_rng(1)
        names = [item.name for item in load_scene(SCENE).deviations]
        frame = pd.DataFrame(0.01 * rng.standard_normal((8, len(names))), columns=names)
        frame.to_parquet(folder / "a.parquet")
        contents["samples.parquet"] = (folder / "a.parquet").read_bytes()
        contents["samples.csv"] = frame.to_csv(index=False).encode()
        contents["table.xlsx"] = workbook({"Points": [row.split(",") for row in TABLE.splitlines()]})
        contents["samples.xlsx"] = workbook({"Samples": [list(frame.columns), *frame.to_numpy().tolist()]})
    contents["table.csv"] = TABLE.encode()
    contents["cloud.csv"] = b"x,y,z,deviation\n0.1,0.1,0,0.01\n0.9,0.2,0,0.02\n0.5,0.8,0,-0.01\n"
    contents["report.csv"] = (
        b"Feature,Axis,Nominal,Actual,Serial\nM1,Y,1.5,1.6,A\nM1,Z,1,1.1,A\nM2,,0,0.1,A\nM2,,0,-0.1,B\n"
    )
    contents["report-pieces.csv"] = b"Feature;Nominal;S1;S2\nM1;100,5;100,62;100,4\nM2;0,0;0,1;\n"
    contents["report.dfq"] = QDAS.encode() + b"0.1\x140\x1427.11.2026/10:15:00\x0f31\x140\nK0014/0 A\n0.2\x0f\x14255\n"
    contents["report-fields.dfq"] = QDAS.encode() + b"K0001/1 0.1\nK0014/1 A\nK0001/2 31\nK0002/2 0\nK0014/2 A\n"
    contents["matrix.mtx"], contents["matrix.txt"] = MATRIX.encode(), ENTRIES.encode()
    contents["scene.toml"] = (SCENE / "scene.toml").read_bytes()
    return contents


def originals_of_gmsh() -> dict[str, bytes]:
    """Content of a valid file of each format that gmsh converts, by name."""
    contents = {}
    with TemporaryDirectory() as name, gmsh_model() as gmsh:
        gmsh.model.occ.addRectangle(0, 0, 0, 20, 10)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(2)
        for suffix in ("step", "stp", "brep", "igs", "med"):
            path = Path(name) / f"a.{suffix}"
            with suppress(Exception):  # gmsh may be built without a format
                gmsh.write(str(path))
                contents[f"gmsh-{path.name}"] = path.read_bytes()
    return contents


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A content with one to four damages: bytes flipped, cut, doubled, moved, or replaced by hostile texts."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(0, len(data) + 1))
        size = int(rng.choice([1, 2, 4, 8, 40]))
        kind = rng.integers(7)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del data[at:]
        elif kind == 2:
            del data[at : at + size]
        elif kind == 3:
            data[at:at] = data[at : at + size] * int(rng.integers(1, 50))
        elif kind == 4:
            data[at : at + size] = TEXTS[rng.integers(len(TEXTS))]
        elif kind == 5:
            lines = bytes(data).splitlines(keepends=True)
            data = bytearray(b"".join(rng.permutation(np.array(lines, dtype=object)).tolist()))
        else:
            numbers = [i for i, byte in enumerate(data) if 48 <= byte < 58]
            if numbers:
                where = numbers[int(rng.integers(len(numbers)))]
                data[where : where + 1] = TEXTS[rng.integers(9)]
    return bytes(data)


def trouble(path: Path) -> str | None:
    """The fault in reading a file; None if it is read, or refused in one sentence."""
    started = time.monotonic()
    try:
        READERS_OF[path.name.partition("-")[0].partition(".")[0]](path)
    except MicError as problem:
        lines = str(problem).splitlines()
        if not lines or str(path) not in lines[0] and path.name not in lines[0]:
            return f"a message without the file: {problem!s:.200}"
    except Exception as problem:
        return f"{type(problem).__name__}: {problem!s:.200}"
    used = time.monotonic() - started
    return f"{used:.0f} s" if used > LONGEST else None


def attack(rng: np.random.Generator, folder: Path) -> list[str]:
    """Failures of a round of damaged files, read in a process of its own."""
    command = [sys.executable, "-m", "support.attack_foreign_files", str(rng.integers(2**31)), str(COUNT)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, cwd=folder)
    except subprocess.TimeoutExpired:
        return [f"{' '.join(command[2:])}: hangs"]
    failures = [line.removeprefix(FAILURE) for line in done.stdout.splitlines() if line.startswith(FAILURE)]
    if done.returncode:
        failures.append(f"{' '.join(command[2:])}: exit status {done.returncode}: {done.stderr[-300:]}")
    return failures


def _main(seed: int, count: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    gmsh_program.LIMIT = LONGEST / 2  # some damaged files let gmsh loop
    contents = list((originals() | originals_of_gmsh()).items())
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name, content = contents[int(rng.integers(len(contents)))]
        with TemporaryDirectory() as folder:
            path = Path(folder) / name
            path.write_bytes(damaged(content, rng))
            (Path(folder) / "matrix.csv").write_text(NODES)
            if problem := trouble(path):
                print(f"{FAILURE}{seed} {number} {name}: {' '.join(problem.split())}", flush=True)


if __name__ == "__main__":
    _main(int(sys.argv[1]), int(sys.argv[2]))
