"""
Lap joint
=========

Two strips, clamped and welded in their overlap: the smallest example with locators, clamps, welds and frictional
contact. The plots show the relative motion of the sheets over the shape deviation of the upper strip, and the contact
forces.
"""

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic import examples

scene = mic.load_scene(examples.folder("lap_joint"))
model = mic.reduce(scene)

# %%
# The corrective force F1 sets the shape of the upper strip. All other deviations have their means.
force = np.linspace(-12.0, 4.0, 33)
deviations = np.tile([deviation.mean for deviation in scene.deviations], (len(force), 1))
deviations[:, model.parameters.index("F1")] = force
result = {law: model.evaluate(deviations, law) for law in scene.report.laws}

# %%
# The relative tangential displacement depends on the contact law. Open contacts are included.
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
for law, evaluation in result.items():
    tangential = evaluation.resolutions["clamp"].displacement[:, :, 1:]
    left.plot(force, 1e3 * np.sqrt((tangential**2).sum(axis=2).mean(axis=1)), label=law)
left.set(xlabel="F1 (N)", ylabel="RMS tangential displacement (µm)")
left.legend()

clamped = result["coulomb"].resolutions["clamp"].force[len(force) // 2]
dots = right.scatter(*model.contacts.point[:, :2].T, c=clamped[:, 0], s=60, cmap="viridis")
right.set(xlabel="x (mm)", ylabel="y (mm)", title="normal force after clamping", aspect="equal")
figure.colorbar(dots, label="N", shrink=0.8)
plt.show()
