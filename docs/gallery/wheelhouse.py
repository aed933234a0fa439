"""
Wheelhouse
==========

Inner and outer wheelhouse with three contact zones along the arch: a synthetic assembly of the paper's kind, here on
a coarse mesh.
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
figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
dots = axis.scatter(model.contacts.point[:, 0], model.contacts.point[:, 2], c=force, s=25, cmap="viridis")
axis.set(xlabel="x (mm)", ylabel="z (mm)", aspect="equal")
figure.colorbar(dots, label="normal force (N)")
plt.show()

# %%
# Key characteristics of all twenty assemblies, beside their tolerances.
figure, axis = plt.subplots(figsize=(8, 3.5), layout="constrained")
for j, item in enumerate(scene.measurements):
    axis.plot(np.full(len(evaluation.measurements), j), evaluation.measurements[:, j], "o", ms=3, color="C0")
    axis.hlines([item.lower, item.upper], j - 0.3, j + 0.3, color="C3")
axis.set_xticks(range(len(scene.measurements)), [item.name for item in scene.measurements])
axis.set_ylabel("mm from nominal")
plt.show()
