"""
Predict assemblies from their measured parts
============================================

Strips were measured before they are joined. Which assemblies will be within their limits, and what can be set where one
will not? ``mic predict`` answers row by row.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import mic
from mic import examples

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))

# %%
# Six assemblies; of the last one the upper strip was not measured.
parts = pd.DataFrame({"F1": [-5, -6, -4, -5.5, -3, np.nan], "F2": [2, 2.5, 4.1, 1, 2.98, 2.4]})
told = mic.predict(model, parts, "coulomb", adjust=["upper-A1", "upper-A3"])
print(told[["row", "measurement", "value", "low", "high", "verdict", "said"]].round(3).to_string(index=False))

# %%
# Intervals hold what was not measured: here the locator, and of the last assembly the upper strip.
colours = {"accepted": "#2e7d32", "open": "#b26a00", "rejected": "#c62828"}
figure, axes = plt.subplots(1, 2, figsize=(9, 3), sharey=True, layout="constrained")
for axis, item in zip(axes, model.scene.measurements):
    own = told[told["measurement"] == item.name]
    axis.axvspan(*item.bounds, color="#e8edf2")
    for row in own.to_dict("records"):
        axis.plot([row["low"], row["high"]], [row["row"]] * 2, color=colours[row["verdict"]], lw=3)
        axis.plot(row["value"], row["row"], "o", color=colours[row["verdict"]])
    axis.set(xlabel=f"{item.name} (mm)")
axes[0].set_ylabel("assembly")
plt.show()
