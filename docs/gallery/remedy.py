"""
Find corrective actions
=======================

The lower limit of M1 of the lap joint is -0.78 mm, and a batch of upper strips has a shifted mean shape. ``mic remedy``
proposes locator adjustments by exact derivatives and evaluates them on fresh samples.
"""

import mic
from mic import examples
from mic.report import pictures

scene = mic.load_scene(examples.folder("lap_joint"))
deviations = [
    item.model_copy(update={"mean": -8.6, "sigma": 0.08}) if item.name == "F1"
    else item.model_copy(update={"sigma": 0.03}) if item.name == "F2"
    else item
    for item in scene.deviations
]  # fmt: skip
limits = [item.model_copy(update={"lower": -0.78}) if item.name == "M1" else item for item in scene.measurements]
model = mic.reduce(scene.model_copy(update={"deviations": deviations, "measurements": limits}))
remedies = mic.remedy(model, "coulomb", samples=8, names=["upper-A1"], capability=0.3)

# %%
# The proposed adjustments, and their effect on fresh samples.
print(remedies.table[["remedy", "adjustment", "change", "reached"]].to_string(index=False))
effects = remedies.effects[(remedies.effects["measurement"] == "M1") & remedies.effects["fresh"]]
print(
    effects[["remedy", "mean_before", "mean", "outside_before", "outside", "gain_low"]].round(3).to_string(index=False)
)

# %%
# The picture of the report: each characteristic with its ±3σ range.
(effect,) = pictures(remedies, model.scene)
effect
