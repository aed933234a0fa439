"""
Explore an assembly interactively
=================================

``mic explore`` opens a page with sliders for sources, locators, clamps and friction. The object behind the page can be
used in scripts, too.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
exploration = mic.explore(model, "coulomb")

# %%
# The inputs, their bounds, and their largest effect as a share of half a tolerance.
for control in exploration.controls:
    print(f"{control.name:24s} {control.low:8.3g} … {control.high:<8.3g} {control.unit:3s} {control.matters:6.2f}")

# %%
# The nominal assembly after clamping: the picture shows the contacts at the end of that stage.
(clamped,) = pictures(exploration.answer(stage="clamp"))
clamped

# %%
# Another shape of the upper strip, and a shim that compensates it.
bent = exploration.answer({"F1": -3.0})
print(bent.table.round(3).to_string(index=False))
shimmed = exploration.answer({"F1": -3.0, "locators.lower-A3": -0.07})
(compensated,) = pictures(shimmed)
compensated

# %%
# The certificate of the solution, and a comparison with ``evaluate``.
print(shimmed.said)
print(float(bent.table["value"][0]), float(model.evaluate({"F1": -3.0}, "coulomb").measurements[0, 0]))

# %%
# The changed fixture as tables to append to the scene file.
print(exploration.scene_tables(shimmed.values))
