"""
How often is a limit missed?
============================

Of a hundred samples none is outside: that says little of one in a hundred thousand. ``mic rare`` walks towards the
misses, level by level, and names the likeliest of them.
"""

import mic
from mic import examples
from mic.report import pictures

scene = mic.load_scene(examples.folder("lap_joint"))
wider = [item.model_copy(update={"lower": -1.4, "upper": 1.4}) for item in scene.measurements]
model = mic.reduce(scene.model_copy(update={"measurements": wider}))
found = mic.rare(model, "coulomb", samples=100)

# %%
# Of a million assemblies so many miss a limit, by simulation and to first order; and what that took.
row = found.table.iloc[0]
print((1e6 * row[["outside", "outside_low", "outside_high", "first_order"]].astype(float)).round(1).to_string())
print(f"{row['levels']} levels, {row['evaluations']} evaluations")

# %%
# The pictures that a report shows of it: the probability, and where the likeliest misses lie.
probabilities, likeliest = pictures(found)
probabilities

# %%
likeliest
