"""
Optimise clamp forces and shims
===============================

``mic optimise`` finds the clamp force and the shim with the largest Cpk under all deviations of the parts. It evaluates
the result on fresh samples, which were not used in the search.
"""

import mic
from mic import examples
from mic.report import pictures
from mic.scene import Scene

lap = mic.load_scene(examples.folder("lap_joint"))
settings = {
    "objective": "cpk",
    "forces": [{"clamps": ["C1-upper", "C1-lower"], "between": [30.0, 120.0]}],
    "shims": [{"of": ["upper-A3"], "between": [-0.5, 0.5]}],
}
model = mic.reduce(Scene(**lap.model_dump() | {"optimise": settings, "folder": lap.folder}))
optimum = mic.optimise(model, "coulomb", samples=20, fresh=60, budget=800)
for change in optimum.changes:
    print(change)
gain = optimum.gain
print(f"least Cpk {optimum.before:.2f} → {optimum.after:.2f}, gain between {gain.low:.2f} and {gain.high:.2f}")

# %%
# The effect on each key characteristic on fresh samples, and the history of the search.
changes, search = pictures(optimum)
changes

# %%
search
