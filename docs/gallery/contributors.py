"""
Contributors to the variance
============================

``mic contributors`` computes the share of each source in the variance of the key characteristics of the lap joint,
interactions included. ``mic order`` computes the changes under other orders of clamps and welds.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
contributors = mic.contributors(model, "coulomb", samples=32, seed=1)

# %%
# Sobol indices: the share of each source alone and including interactions, and the share by a linear analysis.
(shares,) = pictures(contributors)
shares

# %%
# Changes of mean and 6σ under other orders of the process, with the same samples, µm.
orders = mic.order(model, law="coulomb", samples=8)
measured = orders[orders["tolerance"].notna()].set_index(["order", "quantity"])
print((1e3 * measured[["mean_change", "six_sigma_change"]]).round(2).to_string())

# %%
(changes,) = pictures(orders)
changes
