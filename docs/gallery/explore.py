"""
Move an assembly by hand
========================

``mic explore`` opens a page with sliders for sources, locators, clamps and friction. What answers each move is an
object that scripts can move as well, and that gives the same numbers.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
exploration = mic.explore(model, "coulomb")

# %%
# What can be moved, between which bounds, and how much of half a tolerance that takes at most.
for one in exploration.controls:
    print(f"{one.name:24s} {one.low:8.3g} … {one.high:<8.3g} {one.unit:3s} {one.matters:6.2f}")

# %%
# As the scene states it, and at the end of another stage: the picture shows contacts there.
(stated,) = pictures(exploration.answer(stage="clamp"))
stated

# %%
# The upper strip comes in with another force, and a locator is shimmed against it.
bent = exploration.answer({"F1": -3.0})
print(bent.table.round(3).to_string(index=False))
shimmed = exploration.answer({"F1": -3.0, "locators.lower-A3": -0.07})
(mended,) = pictures(shimmed)
mended

# %%
# Each answer comes with its certificate, and is what the model evaluates.
print(shimmed.said)
print(float(bent.table["value"][0]), float(model.evaluate({"F1": -3.0}, "coulomb").measurements[0, 0]))

# %%
# The fixture as it was set, for the end of the scene's file.
print(exploration.scene_tables(shimmed.values))
