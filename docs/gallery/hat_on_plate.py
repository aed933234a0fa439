"""
Hat on plate
============

A hat profile welded to a plate along its two flanges. Where do the flanges slip while the clamps close?
"""

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic import examples
from mic.statistics.draw import draw

scene = mic.load_scene(examples.folder("hat_on_plate"))
model = mic.reduce(scene)

# %%
# Twenty assemblies, drawn as a Monte Carlo would draw them: by seed and number.
evaluation = model.evaluate(draw(scene, seed=1, first=0, count=20), "coulomb")

# %%
# Slip is what each contact pair slid under load, in each stage that resolves contact.
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
