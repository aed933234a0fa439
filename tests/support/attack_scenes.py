"""Mutated scenes: random edits of shipped scenes, each checked, solved and searched for nonsense.

A mutated scene ends in an error of the program, or in results. A failure is any other exception, a round that takes
longer than `LIMIT`, and nonsense that no warning names: results that are not finite, displacements over the size of a
part, forces that no sheet carries.

``script/fuzz scenes`` repeats :func:`attack`.
"""

from __future__ import annotations

import copy
import math
import multiprocessing
import os
import resource
import tomllib
import traceback
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, get_args

import numpy as np

import mic.commands.check as command
from mic.build import reduce
from mic.errors import MicError
from mic.model.assembly import assemble
from mic.scene.load import read_table
from mic.scene.schema import Scene
from mic.statistics.draw import draw
from mic.system.disk_cache import cache_folder

__all__ = ["attack", "mutated", "outcome", "scene_table"]

MESHES = Path(__file__).resolve().parents[2] / "meshes"
SCENES = ("lap_joint", "lap_joint", "lap_joint", "hat_on_plate", "bracket")  # cheap ones more often
LIMIT = 180.0  # s for a scene
MEMORY = 6 * 2**30  # bytes of the process that runs a scene
ROUND = 8  # scenes in a round of :func:`attack`
FORCE = 1e6  # N: the ultimate load of a strip of steel, 1 mm thick and 2 m wide

FACTORS = (1e-6, 1e-3, 0.1, -1.0, 10.0, 1e3, 1e6)
NUMBERS = (0, 0.0, -0.0, 1, -1, 0.5, 1e9, 1e300, -1e300, 5e-324, 10**30, math.nan, math.inf, -math.inf)
TEXTS = (
    "",
    " ",
    "x" * 70,
    "x" * 5000,
    "ä\u202eß",
    "\x1b[31m",
    "a\nb",
    "..",
    "../../etc/passwd",
    "/",
    "%s{0}",
    "[bold]",
)
OTHERS = (None, True, False, "7", "nan", [], {}, [[]], [None], {"a": 1}, 3, 0.25, [1, 2, 3], [0, 0, 0])

#: Items that the shipped scenes lack, as additions to the lap joint.
ADDED: tuple[tuple[str, dict[str, Any]], ...] = (
    ("deviations", {"name": "weight", "kind": "gravity"}),
    ("deviations", {"name": "heat", "kind": "temperature", "mean": 20, "sigma": 5}),
    ("deviations", {"name": "gauge", "kind": "thickness", "part": "upper", "sigma": 0.02}),
    ("deviations", {"name": "mu", "kind": "friction", "target": "lap", "sigma": 0.02, "truncated": [-0.1, 0.1]}),
    ("deviations", {"name": "force", "kind": "clamp", "target": ["C1-upper", "C1-lower"], "sigma": 5}),
    (
        "deviations",
        {"name": "bow", "kind": "shape", "part": "lower", "points": [[50, 5, 0], [50, 20, 0]], "sigma": 0.1},
    ),
    ("deviations", {"name": "waves", "kind": "field", "part": "upper", "sigma": 0.05, "length": 80}),
    ("correlations", {"deviations": ["F1", "F2"], "matrix": [[1, 0.5], [0.5, 1]]}),
    ("fixtures", {"name": "pad", "part": "lower", "point": [30, 12.5, 0], "normal": "-normal", "radius": 5}),
    ("zones", {"name": "rest", "parts": ["lower", "pad"], "friction": 0.2, "pairs": 5}),
    (
        "measurements",
        {"name": "step", "kind": "flush", "part": "lower", "point": [70, 5, 0], "lower": -1, "upper": 1}
        | {"to": {"part": "upper", "point": [110, 5, 1]}},
    ),
    (
        "measurements",
        {"name": "flat", "kind": "profile", "part": "upper", "spacing": 30, "upper": 1, "best_fit": ["flat"]},
    ),
    ("measurements", {"name": "rim", "part": "lower", "hole": [50, 12, 0], "lower": -1, "upper": 1}),
    (
        "measurements",
        {"name": "fitted", "part": "upper", "point": [140, 20, 1], "lower": -1, "upper": 1}
        | {"best_fit": ["M1", "M2"]},
    ),
    ("clamps", {"name": "tong", "parts": ["lower", "upper"], "point": [95, 12.5, 0], "force": 50}),
    ("clamps", {"name": "stroke", "part": "upper", "point": [120, 12.5, 1], "stroke": 0.1, "limit": 200}),
    ("welds", {"name": "W3", "parts": ["lower", "upper"], "point": [64, 12, 0.5], "gun": 500}),
    ("locators", {"name": "late", "part": "lower", "point": [80, 12, 0], "stage": "clamp", "stiffness": 1e4}),
    (
        "optimise",
        {"objective": "largest-six-sigma", "shims": [{"of": ["upper-A3"], "between": [-1, 1]}]}
        | {"places": [{"item": "welds.W1", "points": [[85, 6, 0.5]]}]},
    ),
    ("path", {"tolerance": 0.01}),
)


def scene_table(name: str) -> dict[str, Any]:
    """A shipped scene as a table, on coarse meshes, with few pairs and samples."""
    table = tomllib.loads((MESHES / name / "scene.toml").read_text(encoding="utf-8"))
    for part in table["parts"]:
        part["size"] = "coarse"
    for zone in table["zones"]:
        zone.setdefault("pairs", 6)
    table["monte_carlo"] = {"samples": 10, "seed": 1}
    table["report"] = {"laws": ["coulomb", "frictionless"]}
    return table


def _tables(kind: Any) -> Iterator[Any]:
    """The tables of the schema among the alternatives of a type."""
    if isinstance(kind, type) and hasattr(kind, "model_fields"):
        yield kind
    for inner in get_args(kind):
        yield from _tables(inner)


#: Every key of each table, by the table's key in the scene.
KEYS = {
    key: sorted({name for kind in _tables(field.annotation) for name in kind.model_fields})
    for key, field in Scene.model_fields.items()
}
KINDS = "locate clamp weld release measure force locator shape measured field gravity temperature thickness friction"
KINDS = (*KINDS.split(), *"point flush gap distance parallelism profile".split())


def _places(value: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths of all members of a nested table, its own excluded."""
    for key, member in value.items() if isinstance(value, dict) else enumerate(value):
        yield (*path, key)
        if isinstance(member, dict | list):
            yield from _places(member, (*path, key))


def _random_value(rng: np.random.Generator, value: Any, words: list[str]) -> Any:
    """Another value in place of one."""
    pick = lambda options: options[rng.integers(len(options))]
    if isinstance(value, bool) or rng.random() < 0.1:
        return pick(OTHERS)
    if isinstance(value, int | float):
        return pick(NUMBERS) if rng.random() < 0.4 else value * pick(FACTORS)
    if isinstance(value, str):
        if value in KINDS and rng.random() < 0.7:
            return pick(KINDS)
        return pick(words) if rng.random() < 0.6 else pick(TEXTS)
    if isinstance(value, list) and len(value) and rng.random() < 0.7:
        if all(isinstance(x, int | float) for x in value):
            return [x * pick((*FACTORS, 1.0, 1.0)) for x in value]
        return pick((value + value, value[:-1], value[::-1], value[0], [value]))
    return pick(OTHERS)


def mutated(rng: np.random.Generator) -> tuple[str, dict[str, Any], list[str], list[str]]:
    """A mutated scene: name of the shipped one, table, names of the edited items and keys, and the edits in words."""
    pick = lambda options: options[rng.integers(len(options))]
    name = pick(SCENES)
    table, edits, names = scene_table(name), [], []
    if name == "lap_joint":
        for _ in range(rng.integers(3)):
            key, item = pick(ADDED)
            item = copy.deepcopy(item)
            if key in ("path", "optimise"):
                table[key] = item
            elif item not in table.get(key, []):
                table.setdefault(key, []).append(item)
            edits.append(f"+{key}: {item.get('name', '')}")
            names.append(item.get("name", key))
            if item.get("kind") == "gravity":
                for part in table["parts"]:
                    part["density"] = 7850
            if item.get("kind") == "temperature":
                for part in table["parts"]:
                    part["expansion"] = 1.2e-5
    words = [value for path in _places(table) if isinstance(value := _at(table, path), str)]
    for _ in range(pick((1, 1, 1, 2, 3))):
        path = _place(rng, table)
        names += [_name(table, path), *(key for key in path if isinstance(key, str))]
        edits.append(_mutate(rng, table, path, words))
        names.append(_name(table, path))
    return name, table, sorted({*names} - {""}), edits


def _name(table: dict[str, Any], path: tuple) -> str:
    """The name of the item that a path leads into; empty if it has none."""
    try:
        return str(_at(table, path[:2])["name"])
    except (KeyError, IndexError, TypeError):
        return ""


def _place(rng: np.random.Generator, table: dict[str, Any]) -> tuple:
    """Path of a random member: mostly a key of an item, so that long lists of coordinates do not prevail."""
    pick = lambda options: options[rng.integers(len(options))]
    top = (pick(list(table)),)
    depth = pick((1, 2, 2, 3, 3, 3, 3, 3, 3, 4, 5))
    below = [path for path in _places(table[top[0]], top)] if isinstance(table[top[0]], dict | list) else []
    return pick([path for path in below if len(path) == depth] or below or [top])


def _mutate(rng: np.random.Generator, table: dict[str, Any], path: tuple, words: list[str]) -> str:
    """Change a table in place; returns what was done."""
    pick = lambda options: options[rng.integers(len(options))]
    *above, key = path
    owner = _at(table, above)
    value, at = owner[key], ".".join(map(str, path))
    action = rng.random()
    if isinstance(owner, list) and action < 0.45:
        kind = pick(("delete", "duplicate", "move"))
        if kind == "delete":
            del owner[key]
        elif kind == "duplicate":
            owner.insert(int(rng.integers(len(owner) + 1)), copy.deepcopy(value))
        else:
            owner.insert(int(rng.integers(len(owner))), owner.pop(key))
        return f"{kind} {at}"
    if isinstance(owner, dict) and action < 0.1:
        del owner[key]
        return f"remove {at}"
    if isinstance(owner, dict) and action < 0.13:
        owner[key + "s"] = owner.pop(key)
        return f"rename {at}"
    if isinstance(value, dict) and action < 0.9:  # a key that the schema knows, but this item lacks
        known = KEYS.get(str(path[0]), [])
        if known:
            new = pick(known)
            value[new] = value.get(new, pick((1, 0.5, 2.0, True, "normal", pick(words), [1.0, 2.0, 3.0])))
            if rng.random() < 0.5:
                value[new] = _random_value(rng, value[new], words)
            return f"set {at}.{new} = {value[new]!r}"
    owner[key] = _random_value(rng, value, words)
    return f"set {at} = {str(owner[key])[:80]!r}"


def _at(table: Any, path) -> Any:
    for step in path:
        table = table[step]
    return table


def outcome(name: str, table: dict[str, Any], names: Sequence[str], folder: Path) -> tuple[str, str]:
    """Check and solve a scene.

    Returns
    -------
    end : {"refused", "solved", "failed"}
    said : str
        The error, or nonsense in the results that no warning about one of the `names` mentions.
    """
    try:
        return "solved", _solved(name, table, names, folder)
    except MicError as error:
        return "refused", str(error)
    except Exception:
        return "failed", "".join(traceback.format_exc().splitlines(keepends=True)[-6:])


def _solved(name: str, table: dict[str, Any], names: Sequence[str], folder: Path) -> str:
    """Nonsense in the results of a scene that no warning names; empty if there is none."""
    scene = read_table(copy.deepcopy(table), MESHES / name / "scene.toml")
    _checked(scene, folder)
    model = reduce(scene, cache_folder())
    warned = _checked(scene, folder)  # now with influence coefficients
    found = _nonsense(model, assemble(scene, cache_folder()))
    if found and not any(word in line for line in warned for word in (*names, "measurement ", "stage ")):
        return "; ".join([*found, "but warned of: ", *warned])
    return ""


def _checked(scene, folder: Path) -> list[str]:
    """The warnings that ``mic check`` prints."""
    options = {"law": None, "accuracy": False, "converge": False, "normals": None, "overlap": None, "strict": False}
    with redirect_stdout(StringIO()) as printed:
        command.check(scene, **options, page=folder / "check.html")
    return [line for line in printed.getvalue().splitlines() if line.startswith(("warning:", "implausible:"))]


def _nonsense(model, assembly) -> list[str]:
    """Impossible values in the results of the nominal assembly and of a few samples, by law."""
    found: list[str] = []
    samples = np.vstack([model.deviations({}), draw(model.scene, 1, 0, 3)])
    size = max(part.surface.diameter for part in assembly.parts)
    for law in model.scene.report.laws:
        result = model.evaluate(samples, law)
        good, stages = ~result.failed, result.resolutions.values()
        motions = [result.measurements[good], *(stage.displacement[good] for stage in stages)]
        forces = [array[good] for stage in stages for array in (stage.force, stage.reaction)]
        if not all(np.isfinite(array).all() for array in (*motions, *forces)):
            found.append(f"{law}: results are not finite")
        for text, arrays, limit in (("mm", motions, size), ("N", forces, FORCE)):
            largest = max((np.abs(array).max(initial=0.0) for array in arrays), default=0.0)
            if largest > limit:
                found.append(f"{law}: {largest:.3g} {text}")
    return found


def _serve(connection, cache: Path) -> None:
    """Answer scenes until the connection closes."""
    os.environ["MIC_CACHE"] = str(cache)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    command.load_scene = lambda scene: scene  # these are tables, not files
    while True:
        try:
            given = connection.recv()
        except EOFError:
            return
        connection.send(outcome(*given))


class Server:
    """A process that checks and solves scenes; it is ended and replaced if it takes too long, or dies."""

    def __init__(self, cache: Path):
        self.cache, self.process = cache, None

    def ask(self, name: str, table: dict[str, Any], names: Sequence[str], folder: Path) -> tuple[str, str]:
        """As :func:`outcome`."""
        if self.process is None:
            context = multiprocessing.get_context("spawn")
            self.connection, other = context.Pipe()
            self.process = context.Process(target=_serve, args=(other, self.cache), daemon=True)
            self.process.start()
            other.close()
        self.connection.send((name, table, names, folder))
        try:
            if self.connection.poll(LIMIT):
                return self.connection.recv()
            said = "failed", f"not finished after {LIMIT:g} s"
        except (EOFError, ConnectionError):
            said = "failed", "the process died"
        self.close()
        return said

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None


def attack(rng: np.random.Generator, folder: Path, count: int = ROUND, cache: Path | None = None) -> list[str]:
    """Mutate shipped scenes; returns one line for each failure, with the edits that repeat it."""
    server, failures = Server(cache or folder / "cache"), []
    try:
        for _ in range(count):
            name, table, names, edits = mutated(rng)
            end, said = server.ask(name, table, names, folder)
            if end == "failed" or (end == "solved" and said):
                failures.append(f"{name}: {'; '.join(edits)}: {' | '.join(said.splitlines())}")
    finally:
        server.close()
    return failures
