"""
Find a remedy
=============

The drawing asks for M1 of the lap joint to be above -0.78 mm, but the upper strips of a batch come in with too large
a force. Which locator would bring the assemblies back, and how far? ``mic remedy`` proposes changes by exact
derivatives and evaluates them on fresh samples.
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
found = mic.remedy(model, "coulomb", samples=8, names=["upper-A1"], capability=0.3)

# %%
# What to set, and what that does: on the samples that it was found by, and on fresh ones.
print(found.table[["remedy", "adjustment", "change", "reached"]].to_string(index=False))
effects = found.effects[(found.effects["measurement"] == "M1") & found.effects["fresh"]]
print(
    effects[["remedy", "mean_before", "mean", "outside_before", "outside", "gain_low"]].round(3).to_string(index=False)
)

# %%
# The picture that a report shows of it: each characteristic with three standard deviations to either side.
(done,) = pictures(found, model.scene)
done
