"""
Find what drives a characteristic
=================================

Which source makes the key characteristics of the lap joint scatter, and does the order matter in which the process
closes? ``mic contributors`` gives shares of the variance, interactions included; ``mic order`` the changes under other
orders.
"""

import matplotlib.pyplot as plt
import numpy as np

import mic
from mic import examples

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
found = mic.contributors(model, "coulomb", samples=32, seed=1)

# %%
# Sobol's indices: the share of the variance that goes if a source is held fixed, with its interval.
figure, axes = plt.subplots(1, 2, figsize=(9, 2.8), sharey=True, layout="constrained")
for axis, (name, own) in zip(axes, found.table.groupby("measurement")):
    ends = np.abs(own[["total_low", "total_high"]].to_numpy().T - own["total"].to_numpy())
    axis.barh(own["contributor"], own["total"], xerr=ends, color="#0b5cad", ecolor="#58626e", height=0.5)
    axis.set(title=name, xlabel="share of the variance")
plt.show()

# %%
# The same samples under other orders of the process: changes of mean and 6σ, µm.
told = mic.order(model, law="coulomb", samples=8)
measured = told[told["tolerance"].notna()].set_index(["order", "quantity"])
print((1e3 * measured[["mean_change", "six_sigma_change"]]).round(2).to_string())
