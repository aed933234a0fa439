"""A scene of one curved part, meshed by a script at any size or read from a file."""

import re

import numpy as np

import mic
from mic.geometry.readers.vtu import write_vtu
from mic.model.assembly import assemble

#: Height of the sheet over x and y, mm
CROWN = "10 * np.sin(np.pi * x / 120) * np.sin(np.pi * y / 80) + 4 * np.sin(np.pi * x / 120)"

SCRIPT = '''
import numpy as np

SIZES = {"usual": 10.0}


def build(part, size):
    """120 × 80 mm, divided into squares of `size` and these along diagonals that alternate."""
    m, n = round(120 / size), round(80 / size)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 120, m + 1), np.linspace(0, 80, n + 1), indexing="ij"))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(m), np.arange(n), indexing="ij"))
    a = i * (n + 1) + j
    b, c, d = a + n + 1, a + n + 2, a + 1
    odd = ((i + j) % 2 == 1)[:, None]
    first = np.where(odd, np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    second = np.where(odd, np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    z = HEIGHT
    return np.column_stack([x, y, z]), np.concatenate([first, second])
'''

SCENE = """
name = "curved"

[[parts]]
name = "sheet"
{source}
thickness = 1.0
{locators}
[[stages]]
kind = "locate"

[[stages]]
kind = "clamp"

[[stages]]
kind = "measure"

[[clamps]]
name = "push"
part = "sheet"
point = [70, 40, 14]
direction = [0, 0, -1]
force = 20
radius = 8

[[deviations]]
name = "dent"
kind = "force"
part = "sheet"
point = [100, 60, 7]
direction = [0, 0, -1]
sigma = 1
radius = 8

[[measurements]]
name = "K"
part = "sheet"
point = [30, 60, 9]
direction = [0, 0, 1]
lower = -1
upper = 1
radius = 8
"""

LOCATOR = """
[[locators]]
name = "{name}"
part = "sheet"
point = {point}
direction = {direction}
stage = "{stage}"
radius = 6
"""
HELD = {
    "z1": ([20, 20, 7], [0, 0, 1], "locate"),
    "z2": ([100, 20, 7], [0, 0, 1], "locate"),
    "z3": ([60, 70, 7], [0, 0, 1], "locate"),
    "y1": ([20, 20, 7], [0, 1, 0], "locate"),
    "y2": ([100, 20, 7], [0, 1, 0], "locate"),
    "x1": ([20, 20, 7], [1, 0, 0], "locate"),
    "z4": ([100, 70, 5], [0, 0, 1], "clamp"),
}


def curved_scene(folder, size=None, mesh=None, accuracy=None, keys="", height=CROWN):
    """The scene in a folder, of its script at a size in mm or to an accuracy, or of a mesh (points, triangles) that is
    written there; its points on a sheet of the given height."""
    (folder / "panel.py").write_text(SCRIPT.replace("HEIGHT", height))
    source = 'geometry = "panel.py"\n' + (f"size = {size}" if accuracy is None else f"accuracy = {accuracy}")
    if mesh is not None:
        write_vtu(folder / "panel.vtu", *mesh)
        source = 'mesh = "panel.vtu"'
    locators = [
        LOCATOR.format(name=name, point=point, direction=direction, stage=stage)
        for name, (point, direction, stage) in HELD.items()
    ]
    text = SCENE.format(source=source, locators="".join(locators)) + keys
    (folder / "scene.toml").write_text(re.sub(r"point = \[([^]]*)\]", lambda found: _lifted(found[1], height), text))
    return mic.load_scene(folder)


def _lifted(point, height):
    x, y, _ = (float(value) for value in point.split(","))
    return f"point = [{x}, {y}, {eval(height, {'np': np, 'x': x, 'y': y}):.6f}]"


def curved_assembly(folder, cache, **how):
    """The scene of :func:`curved_scene` put on its mesh."""
    return assemble(curved_scene(folder, **how), cache)


def mesh_of(size, height=CROWN):
    """Points and triangles that the script makes."""
    names = {}
    exec(SCRIPT.replace("HEIGHT", height), names)
    return names["build"]("sheet", size)


def held_compliance(model):
    """Compliance of force, clamp and measurement rows, held by the first six locators and by all."""
    from scipy.sparse import csr_matrix, vstack

    from mic.compliance.elimination import eliminate

    rows = vstack([model.rows["clamp"], model.rows["force"]], format="csr")
    reading = vstack([rows, model.rows["measurement"]], format="csr")
    none = csr_matrix((0, rows.shape[1]))
    return [
        np.array(eliminate(model.compliance, model.rows["locator"][held], none, rows, reading).L_out)
        for held in (slice(0, 6), slice(None))
    ]
