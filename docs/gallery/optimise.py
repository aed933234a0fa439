"""
An optimum
==========

Which force of the clamp, and which shims, bring most lap joints within their limits? Not the nominal one: all that the
parts' deviations make of them. What is found is judged on samples that had no part in finding it.
"""

import mic
from mic import examples
from mic.report import pictures
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
# What that does to every characteristic, of samples that had no part in the search, and how the search went.
changes, search = pictures(found)
changes

# %%
search
