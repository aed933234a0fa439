"""
Does friction matter?
=====================

Coefficients of friction are hardly ever known well. ``mic friction`` takes the same lap joints through the process
with all friction left out, halved and doubled, and says whether the answer would have been another.
"""

import mic
from mic import examples
from mic.report import pictures
from mic.report.driver_sentences import friction_words
from mic.studies.friction import friction_needed

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
found = mic.friction(model, "coulomb", samples=20)

# %%
# Changes of mean and 6σ, µm, of the same samples; and how well friction must be known for the answer to hold.
whole = found[found["zone"] == ""].set_index(["measurement", "factor"])
print((1e3 * whole[["mean_change", "six_sigma_change", "six_sigma"]]).round(2).to_string())
print("\n".join(friction_words(found, friction_needed(found))))

# %%
# The picture that a report shows of it: in the grey band, a tenth of 6σ to either side, the answer holds.
(changes,) = pictures(found)
changes
