"""
What a step of each input changes
=================================

A locator that stands a tenth of a millimetre off, a clamp that pushes a tenth harder, a force by its standard
deviation: by how much do the key characteristics of the lap joint move? ``mic sensitivity`` answers by exact
derivatives, contact and friction included.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
found = mic.sensitivity(model, "coulomb", samples=10)

# %%
# About the mean assembly, and the range over ten others, µm; and how far the mean assembly is from where a contact
# changes its state, beyond which the derivatives are others.
largest = found.table.assign(size=found.table["effect"].abs()).nlargest(6, "size")
told = largest[["measurement", "input", "step", "effect", "effect_low", "effect_high"]]
print(told.assign(**{name: 1e3 * told[name] for name in told if "effect" in name}).round(2).to_string(index=False))
print(f"The mean assembly is {found.reach:.2g} σ from the next change: {found.where}")

# %%
# The picture that a report shows of it.
(steps,) = pictures(found)
steps
