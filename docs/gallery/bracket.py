"""
Bracket
=======

Three sheets of three materials, joined in two steps. What does each step leave in the key characteristics?
"""

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic import examples
from mic.statistics.draw import draw

scene = mic.load_scene(examples.folder("bracket"))
model = mic.reduce(scene)

# %%
# Ten assemblies under Coulomb's law, and the same ten without friction.
deviations = draw(scene, seed=1, first=0, count=10)
measured = {law: model.evaluate(deviations, law).measurements for law in ("coulomb", "frictionless")}

# %%
# What friction changes of each key characteristic, one dot an assembly.
figure, axis = plt.subplots(figsize=(7, 3.2), layout="constrained")
change = 1e3 * (measured["coulomb"] - measured["frictionless"])
for k in range(len(scene.measurements)):
    axis.scatter(change[:, k], np.full(len(change), k), s=24, alpha=0.7)
axis.axvline(0, color="k", lw=0.8)
axis.set(
    yticks=range(len(scene.measurements)),
    yticklabels=[item.name for item in scene.measurements],
    xlabel="with friction − without (µm)",
)
axis.invert_yaxis()
plt.show()

# %%
# The forces that each zone carries while the assembly is clamped and after it was released, N in the mean.
evaluation = model.evaluate(deviations, "coulomb")
for stage, resolution in evaluation.resolutions.items():
    normal = resolution.force[..., 0]
    of_zone = [normal[:, model.contacts.zone == k].sum(axis=1).mean() for k in range(len(scene.zones))]
    print(stage, dict(zip([zone.name for zone in scene.zones], np.round(of_zone, 1).tolist())))
