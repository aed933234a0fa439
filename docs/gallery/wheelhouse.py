"""
Wheelhouse
==========

Inner and outer wheelhouse with three contact zones along the arch: a synthetic assembly of the paper's kind, on a coarse mesh here.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic.sampling.draw import draw

meshes = next(folder for folder in Path.cwd().parents if (folder / "meshes").is_dir()) / "meshes"
scene = mic.load_scene(meshes / "wheelhouse")
coarse = [part.model_copy(update={"size": "coarse"}) for part in scene.parts]
scene = scene.model_copy(update={"parts": coarse})
model = mic.reduce(scene)

# %%
# Contact forces of one assembly after clamping: few of the candidate pairs carry load.
evaluation = model.evaluate(draw(scene, seed=1, first=0, count=20), "coulomb")
force = evaluation.resolutions["clamp"].force[0, :, 0]
figure = plt.figure(figsize=(9, 4.5), layout="constrained")
axis = figure.add_subplot(121, projection="3d")
point = model.contacts.point
dots = axis.scatter(*point.T, c=force, s=12, cmap="viridis")
axis.set(xlabel="x (mm)", ylabel="y", zlabel="z", box_aspect=np.ptp(point, axis=0) + 50)
figure.colorbar(dots, label="normal force (N)", shrink=0.6)

# %%
# Key characteristics of all twenty assemblies, beside their tolerances.
axis = figure.add_subplot(122)
for j, item in enumerate(scene.measurements):
    axis.plot(np.full(len(evaluation.measurements), j), evaluation.measurements[:, j], "o", ms=3, color="C0")
    axis.hlines([item.lower, item.upper], j - 0.3, j + 0.3, color="C3")
axis.set_xticks(range(len(scene.measurements)), [item.name for item in scene.measurements])
axis.set_ylabel("mm from nominal")
plt.show()
