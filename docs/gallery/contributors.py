"""
Find what drives a characteristic
=================================

Which source makes the key characteristics of the lap joint scatter, and does the order matter in which the process
closes? ``mic contributors`` gives shares of the variance, interactions included; ``mic order`` the changes under other
orders.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
found = mic.contributors(model, "coulomb", samples=32, seed=1)

# %%
# Sobol's indices: the share of the variance that a source makes alone and with others, and what a linear analysis says.
(shares,) = pictures(found)
shares

# %%
# The same samples under other orders of the process: changes of mean and 6σ, µm.
told = mic.order(model, law="coulomb", samples=8)
measured = told[told["tolerance"].notna()].set_index(["order", "quantity"])
print((1e3 * measured[["mean_change", "six_sigma_change"]]).round(2).to_string())

# %%
(changes,) = pictures(told)
changes
