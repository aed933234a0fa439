"""
Bracket
=======

Three sheets of three materials, joined in two steps: the effect of friction on the key characteristics, and the forces
that the contact zones transmit.
"""

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic import examples
from mic.statistics.draw import draw

scene = mic.load_scene(examples.folder("bracket"))
model = mic.reduce(scene)

# %%
# The same ten assemblies with Coulomb friction and without friction.
deviations = draw(scene, seed=1, first=0, count=10)
evaluations = {law: model.evaluate(deviations, law) for law in ("coulomb", "frictionless")}

# %%
# Change of each key characteristic by friction; one dot per assembly.
figure, axis = plt.subplots(figsize=(7, 3.2), layout="constrained")
change = 1e3 * (evaluations["coulomb"].measurements - evaluations["frictionless"].measurements)
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
# Mean normal force of each zone in N, clamped and released.
for stage, resolution in evaluations["coulomb"].resolutions.items():
    normal = resolution.force[..., 0]
    zone_force = [normal[:, model.contacts.zone == k].sum(axis=1).mean() for k in range(len(scene.zones))]
    print(stage, dict(zip([zone.name for zone in scene.zones], np.round(zone_force, 1).tolist())))
