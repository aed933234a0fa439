"""
Without finite elements
=======================

A part may be given by a stiffness matrix from any program. Here a lattice of beams stands for each strip of the lap
joint, so that this page and its notebook run wherever ``pip`` installs mic-contact: no finite elements are needed.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.io import mmwrite
from scipy.sparse import coo_matrix

import mic
from mic import examples
from mic.geometry.readers.vtu import write_vtu
from mic.geometry.structured import extrude
from mic.report import pictures

YOUNG, THICKNESS, SPACING = 210e3, 1.0, 5.0  # MPa, mm, mm


# %%
# Stiffness of a beam between two nodes: springs between the motions of both at its middle, which is exact for slender
# beams. The matrix of a part has six freedoms for each node, and resists no rigid motion.
def lattice(points, edges):
    matrix = np.zeros((6 * len(points), 6 * len(points)))
    for i, j in edges:
        arm = (points[j] - points[i]) / 2
        length, half = 2 * np.linalg.norm(arm), np.cross(np.eye(3), arm).T  # half @ θ = θ × arm
        axes = np.array([arm, np.cross([0, 0, 1], arm), [0, 0, length / 2]]) / (length / 2)  # along, across, normal
        relative = np.zeros((6, len(points), 6))
        relative[:3, j, :3], relative[:3, i, :3] = axes, -axes
        relative[:3, j, 3:] = relative[:3, i, 3:] = -axes @ half
        relative[3:, j, 3:], relative[3:, i, 3:] = axes, -axes
        relative = relative.reshape(6, -1)
        bend, sway = SPACING * THICKNESS**3 / 12, THICKNESS * SPACING**3 / 12  # second moments of area
        stretch = [SPACING * THICKNESS / length, 12 * sway / length**3, 12 * bend / length**3]
        turn = [4 * bend / 2.6 / length, bend / length, sway / length]
        matrix += YOUNG * (relative.T * [*stretch, *turn]) @ relative
    return matrix


# %%
# The example scene, with a mesh file and a matrix for each part in place of its geometry script.
folder = examples.copy("lap_joint", Path(tempfile.mkdtemp()) / "lap_joint")
text = (folder / "scene.toml").read_text(encoding="utf-8").replace("fields = true", "fields = false")
text = text.replace('name = "lap"', 'name = "lap"\npairs = 24')
for name, start, height in (("lower", 0.0, 0.0), ("upper", 60.0, THICKNESS)):
    points, triangles, _ = extrude([(0.0, height), (25.0, height)], start, 100.0, SPACING)
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))
    edges = [(i, j) for i, j in np.unique(sides, axis=0) if np.linalg.norm(points[j] - points[i]) < 1.1 * SPACING]
    write_vtu(folder / f"{name}.vtu", points, triangles)
    mmwrite(folder / f"{name}.mtx", coo_matrix(lattice(points, edges)))
    nodes = "".join(f"{node},{x},{y},{z}\n" for node, (x, y, z) in enumerate(points.tolist(), 1))
    (folder / f"{name}.csv").write_text("node,x,y,z\n" + nodes)
    script = 'geometry = "geometry.py"\nsize = "medium"'
    text = text.replace(script, f'mesh = "{name}.vtu"\nstiffness = "{name}.mtx"', 1)
(folder / "scene.toml").write_text(text, encoding="utf-8")
scene = mic.load_scene(folder)

# %%
# From here on, everything is as with finite elements. A saved model evaluates on any machine. At the end of a cell, a
# model shows itself.
mic.reduce(scene).save(folder / "model.npz")
model = mic.ReducedModel.load(folder / "model.npz")
model

# %%
# Names stand for deviations, and missing ones take their means. Results are arrays, and tables on request.
print(model.evaluate({"F1": [-7.0, -5.0], "D1": 0.08}).to_frame().round(3).to_string())

# %%
# Samples are a DataFrame with a column for each deviation. It may come from anywhere: columns are found by name.
samples = model.sample(100)
print(samples.head(3).round(3).to_string(), samples.attrs["units"])

# %%
# A friction sweep: the same 100 assemblies with other coefficients.
sweep = {mu: model.evaluate(samples, "coulomb", friction=mu) for mu in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)}
measured = pd.concat({mu: found.to_frame("measurements") for mu, found in sweep.items()}, names=["friction"])
summary = measured.groupby("friction").agg(["mean", lambda column: 6 * column.std()])
summary.columns = [f"{kind} of {name}, mm" for name in measured for kind in ("mean", "6σ")]
print(summary.round(4).to_string())

# %%
# State of the contact pairs that press on each other while the clamps are closed: stick or slip.
contacts = pd.concat({mu: found.to_frame("contacts") for mu, found in sweep.items()}, names=["friction"]).reset_index(0)
pressing = contacts[(contacts["stage"] == "clamp") & (contacts["state"] != "open")]
slipping = (pressing["state"] == "slip").groupby(pressing["friction"]).mean()

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for name in measured:
    change = measured[name].unstack("friction")
    change = 1e3 * change.sub(change[0.0], axis=0)
    left.errorbar(change.columns, change.mean(), change.std(), marker="o", capsize=3, label=name)
left.set(xlabel="coefficient of friction", ylabel="change by friction (µm), mean ± σ")
left.legend()
right.plot(100 * slipping, "o-")
right.set(xlabel="coefficient of friction", ylabel="pressing pairs that slip (%)", ylim=(0, 105))
plt.show()

# %%
# Which deviation causes the scatter. A bar shows the progress of longer computations in a notebook; `progress=False`
# turns it off.
(shares,) = pictures(mic.contributors(model, "coulomb", samples=32, seed=1, progress=False))
shares
