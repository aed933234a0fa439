"""
Explain a measured assembly
===========================

Both key characteristics of a lap joint are measured, and one is far from nominal. ``mic explain`` estimates the
deviations of its sources by Bayes' rule, contact and friction included.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
explanation = mic.explain(model, {"M1": 0.626, "M2": 0.763}, gauge=0.002, law="coulomb")

# %%
# Each source with its 95 % credible interval, its distance from the mean in standard deviations (``off``), and the
# share of its variance that the measurement removes (``told``).
print(explanation.table[["source", "mean", "low", "high", "off", "told"]].round(2).to_string(index=False))

# %%
# The pictures of the report of ``mic explain``: the sources before and after the measurement, and the resulting key
# characteristics.
sources, reached = pictures(explanation)
sources

# %%
reached

# %%
# With M2 alone the two forces cannot be distinguished. ``further`` ranks further measurements by their information.
m2_only = mic.explain(model, {"M2": 0.763}, gauge=0.002, law="coulomb")
print(m2_only.further[["measurement", "bits", "source", "told"]].round(2).to_string(index=False))
