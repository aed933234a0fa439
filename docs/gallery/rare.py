"""
Small failure probabilities
===========================

A hundred samples without a rejected assembly say little about a failure rate of one in a hundred thousand. ``mic rare``
estimates it by subset simulation and gives the most probable failure.
"""

import mic
from mic import examples
from mic.report import pictures

scene = mic.load_scene(examples.folder("lap_joint"))
wider = [item.model_copy(update={"lower": -1.25, "upper": 1.25}) for item in scene.measurements]
model = mic.reduce(scene.model_copy(update={"measurements": wider}))
result = mic.rare(model, "coulomb", samples=100)

# %%
# Failures per million assemblies by simulation, with interval, and to first order; and the number of evaluations.
row = result.table.iloc[0]
print((1e6 * row[["outside", "outside_low", "outside_high", "first_order"]].astype(float)).round(1).to_string())
print(f"{row['levels']} levels, {row['evaluations']} evaluations")

# %%
# The pictures of the report: the failure probability, and the most probable failure.
probabilities, likeliest = pictures(result)
probabilities

# %%
likeliest
