"""
Effect of friction
==================

Coefficients of friction are rarely known well. ``mic friction`` computes the same samples without friction, with half
and with twice the coefficients, and reports how accurately friction must be known.
"""

import mic
from mic import examples
from mic.report import pictures
from mic.report.driver_sentences import friction_words
from mic.studies.friction import friction_needed

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
effect = mic.friction(model, "coulomb", samples=20)

# %%
# Changes of mean and 6σ, µm, and the required accuracy of the coefficients.
all_zones = effect[effect["zone"] == ""].set_index(["measurement", "factor"])
print((1e3 * all_zones[["mean_change", "six_sigma_change", "six_sigma"]]).round(2).to_string())
print("\n".join(friction_words(effect, friction_needed(effect))))

# %%
# The picture of the report. The grey band is ±10 % of 6σ.
(changes,) = pictures(effect)
changes
