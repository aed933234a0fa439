"""
Predict assemblies from their measured parts
============================================

Strips were measured before they are joined. Which assemblies will be within their limits, and what can be set where one
will not? ``mic predict`` answers row by row.
"""

import numpy as np
import pandas as pd

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))

# %%
# Six assemblies; of the last one the upper strip was not measured.
parts = pd.DataFrame({"F1": [-5, -6, -4, -5.5, -3, np.nan], "F2": [2, 2.5, 4.1, 1, 2.98, 2.4]})
told = mic.predict(model, parts, "coulomb", adjust=["upper-A1", "upper-A3"])
print(told[["row", "measurement", "value", "low", "high", "verdict", "said"]].round(3).to_string(index=False))

# %%
# Intervals hold what was not measured: here the locator, and of the last assembly the upper strip.
(foretold,) = pictures(told, model.scene)
foretold
