"""
Compare before and after
========================

The lap joint is sealed with an adhesive primer that halves its friction. What does that do to its key characteristics?
``mic compare`` takes both through the same samples, so that little scatter is left in the differences.
"""

import mic
from mic import examples
from mic.report import pictures

scene = mic.load_scene(examples.folder("lap_joint"))
primed = scene.model_copy(update={"zones": [zone.model_copy(update={"friction": 0.135}) for zone in scene.zones]})
found = mic.compare(mic.reduce(scene), mic.reduce(primed), ["coulomb"], samples=40)

# %%
# What the second scene says otherwise, and by how much each mean and 6σ moves (µm), with intervals that hold in 95 %.
print("\n".join(found.changes))
measured = found.table[found.table["quantity"].isin(["M1", "M2"])]
columns = [f"{figure}_change{end}" for figure in ("mean", "six_sigma") for end in ("", "_low", "_high")]
print((1e3 * measured.set_index("quantity")[columns]).round(2).T)

# %%
# The pictures of the page that ``mic compare`` writes.
changes, distributions = pictures(found)
changes

# %%
distributions
