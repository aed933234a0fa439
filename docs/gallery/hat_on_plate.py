"""
Hat on plate
============

A hat profile welded to a plate along its two flanges, on a coarse mesh: slip of the flanges in each stage.
"""

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic import examples
from mic.statistics.draw import draw

scene = mic.load_scene(examples.folder("hat_on_plate"))
scene = scene.model_copy(update={"parts": [part.model_copy(update={"size": "coarse"}) for part in scene.parts]})
model = mic.reduce(scene)

# %%
# The first eight samples of a Monte Carlo with seed 1.
evaluation = model.evaluate(draw(scene, seed=1, first=0, count=8), "coulomb")

# %%
# RMS slip of each contact pair, by stage.
stages = list(evaluation.resolutions)
figure, axes = plt.subplots(1, len(stages), figsize=(9, 3.2), sharey=True, layout="constrained")
for axis, stage in zip(np.atleast_1d(axes), stages):
    slip = np.linalg.norm(evaluation.resolutions[stage].trace.slip, axis=2)
    rms = np.sqrt((slip**2).mean(axis=0))
    dots = axis.scatter(*model.contacts.point[:, :2].T, c=1e3 * rms, s=40, cmap="viridis")
    axis.set(xlabel="x (mm)", title=stage, aspect="equal")
    figure.colorbar(dots, ax=axis, label="RMS slip (µm)", orientation="horizontal")
np.atleast_1d(axes)[0].set_ylabel("y (mm)")
plt.show()
