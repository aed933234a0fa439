"""
Explain a measured assembly
===========================

Both key characteristics of a lap joint were measured, one of them far off. Which source was it? ``mic explain`` goes
back by Bayes' rule, with contact and friction as they are.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
found = mic.explain(model, {"M1": 0.626, "M2": 0.763}, gauge=0.002, law="coulomb")

# %%
# Each source with the interval that holds it in 95 %, how many standard deviations it is off its mean, and the share of
# its variance that the measurement takes away.
print(found.table[["source", "mean", "low", "high", "off", "told"]].round(2).to_string(index=False))

# %%
# The pictures of the page that ``mic explain`` writes: sources before and after, and what they give.
sources, reached = pictures(found)
sources

# %%
reached

# %%
# Had M2 alone been measured, the two forces could not be told apart. What further point would tell most?
less = mic.explain(model, {"M2": 0.763}, gauge=0.002, law="coulomb")
print(less.further[["measurement", "bits", "source", "told"]].round(2).to_string(index=False))
