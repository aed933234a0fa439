"""
Predict assemblies from their measured parts
============================================

The strips are measured before they are joined. ``mic predict`` predicts for each assembly whether it will be within its
limits, and proposes adjustments if not.
"""

import numpy as np
import pandas as pd

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))

# %%
# Six assemblies; the upper strip of the last one was not measured.
parts = pd.DataFrame({"F1": [-5, -6, -4, -5.5, -3, np.nan], "F2": [2, 2.5, 4.1, 1, 2.98, 2.4]})
predictions = mic.predict(model, parts, "coulomb", adjust=["upper-A1", "upper-A3"])
print(predictions[["row", "measurement", "value", "low", "high", "verdict", "said"]].round(3).to_string(index=False))

# %%
# The intervals include what was not measured: the locator, and the upper strip of the last assembly.
(intervals,) = pictures(predictions, model.scene)
intervals
