"""
Adjust fifty cars, each in its own way
======================================

Fifty cars pass the wheelhouse station. The deviations of their parts are measured, and ``mic predict --adjust`` shifts
the sixteen locators that are no datum for each car, by at most 1 mm. Here the deviations are drawn from the
distributions of the scene; with ``--scan`` they come from scans of the parts.
"""

import time

import numpy as np
import pandas as pd

import mic
from mic import examples
from mic.report import pictures
from mic.statistics.draw import draw
from mic.studies.adjustable import Adjustable
from mic.studies.adjustment import adjustments
from mic.studies.comparison import Comparison, Side, differences
from mic.studies.joint_adjustment import JointAdjustment

scene = mic.load_scene(examples.folder("wheelhouse"))
limits = {"lower": -0.8, "upper": 0.8}
scene = scene.model_copy(
    update={
        "parts": [part.model_copy(update={"size": "coarse"}) for part in scene.parts],
        "measurements": [item.model_copy(update=limits) for item in scene.measurements],
    }
)
model = mic.reduce(scene)
locators = [item.targets[0] for item in adjustments(model) if item.kind == "locator"]

# %%
# All cars aim at one target: what the mean car reaches with nine tenths of each range. Each proposal is an evaluation
# of the car with contact and friction.
start = time.process_time()
planner = JointAdjustment(model, "coulomb", Adjustable(locators, shim=1.0, objective="rms"))
cars = draw(scene, 2026, 0, 50)
proposals = [planner.propose(car, np.zeros(len(scene.measurements))) for car in cars]
minutes = (time.process_time() - start) / 60
before, after = (np.array([getattr(one, side) for one in proposals]) for side in ("before", "after"))
print(f"{len(cars)} cars, {len(locators)} locators: {minutes:.1f} minutes of one core")
print(f"largest residual of the contact conditions: {max(one.residual for one in proposals):.0e}")
for name, y in (("before", before), ("after", after)):
    good = (np.abs(y) <= 0.8).all(axis=1).sum()
    print(
        f"{name}: {good} good cars, 6σ {6 * y.std(axis=0, ddof=1).mean():.3f} mm, RMS {np.sqrt((y**2).mean()):.2f} mm"
    )

# %%
# Distributions of the key characteristics before and after.
names = [item.name for item in scene.measurements]
tables = {"as it is": before, "adjusted": after}
sides = [Side(name, scene, "coulomb", pd.DataFrame(y, columns=names)) for name, y in tables.items()]
changes, distributions = pictures(Comparison(*sides, differences(*sides)[0], [], 0, []))
distributions

# %%
# The car that remains farthest from its limits' middle. The locators at an end of their range show why: a larger range,
# or better parts, would be needed.
worst = int(np.abs(after).max(axis=1).argmax())
car, k = proposals[worst], int(np.abs(after[worst]).argmax())
ends = [item.targets[0] for item, change in car.changes.items() if abs(change) > 0.95]
print(f"car {worst}: {names[k]} {before[worst, k]:+.2f} mm, adjusted {after[worst, k]:+.2f} mm, limits ±0.8 mm")
print(f"at the end of their range: {', '.join(ends) or 'none'}")
unlimited = JointAdjustment(model, "coulomb", Adjustable(locators, shim=3.0, objective="rms"))
reached = unlimited.propose(cars[worst], np.zeros(len(names))).after[k]
print(f"{names[k]} with ±3 mm instead of ±1 mm: {reached:+.2f} mm")
