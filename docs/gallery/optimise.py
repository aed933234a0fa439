"""
An optimum
==========

Which force of the clamp, and which shims, bring most lap joints within their limits? Not the nominal one: all that the
parts' deviations make of them. What is found is judged on samples that had no part in finding it.
"""

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic import examples
from mic.sampling.draw import draw
from mic.scene import Scene

lap = mic.load_scene(examples.folder("lap_joint"))
asked = {
    "objective": "cpk",
    "forces": [{"clamps": ["C1-upper", "C1-lower"], "between": [30.0, 120.0]}],
    "shims": [{"of": ["upper-A3"], "between": [-0.5, 0.5]}],
}
model = mic.reduce(Scene(**lap.model_dump() | {"optimise": asked, "folder": lap.folder}))
found = mic.optimise(model, "coulomb", samples=40, fresh=100, budget=1500)
for change in found.changes:
    print(change)
print(f"least Cpk {found.before:.2f} → {found.after:.2f}, gain between {found.gain.low:.2f} and {found.gain.high:.2f}")

# %%
# What that does to every characteristic, of samples that are neither those of the search nor those of the judgement.
after = mic.reduce(found.scene)
samples = draw(lap, lap.monte_carlo.seed, 1000, 100)
more = np.zeros((100, len(after.parameters) - len(model.parameters)))
more[:] = [one.mean for one in found.scene.deviations[len(model.parameters) :]]
both = (
    model.evaluate(samples, "coulomb").measurements,
    after.evaluate(np.hstack([samples, more]), "coulomb").measurements,
)
figure, axes = plt.subplots(1, len(lap.measurements), figsize=(9, 3.2), layout="constrained")
for k, (item, axis) in enumerate(zip(lap.measurements, axes)):
    edges = np.linspace(min(y[:, k].min() for y in both), max(y[:, k].max() for y in both), 25)
    for y, label in zip(both, ("as it is", "optimised")):
        axis.hist(y[:, k], edges, alpha=0.6, label=label)
    for limit in (item.lower, item.upper):
        axis.axvline(limit, color="0.3", linestyle="--")
    axis.set(title=item.name, xlabel="mm")
axes[0].legend()
plt.show()
