"""
Compare two scenes
==================

An adhesive primer halves the friction of the lap joint. ``mic compare`` computes both scenes with the same samples, so
that the differences of the key characteristics have little sampling error.
"""

import mic
from mic import examples
from mic.report import pictures

scene = mic.load_scene(examples.folder("lap_joint"))
primed = scene.model_copy(update={"zones": [zone.model_copy(update={"friction": 0.135}) for zone in scene.zones]})
comparison = mic.compare(mic.reduce(scene), mic.reduce(primed), ["coulomb"], samples=40)

# %%
# The changed keys of the scene, and the change of each mean and 6σ (µm) with its 95 % confidence interval.
print("\n".join(comparison.changes))
measured = comparison.table[comparison.table["quantity"].isin(["M1", "M2"])]
columns = [f"{figure}_change{end}" for figure in ("mean", "six_sigma") for end in ("", "_low", "_high")]
print((1e3 * measured.set_index("quantity")[columns]).round(2).T)

# %%
# The pictures of the report of ``mic compare``.
changes, distributions = pictures(comparison)
changes

# %%
distributions
