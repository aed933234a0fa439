"""
Sensitivities
=============

``mic sensitivity`` computes the change of the key characteristics per step of each input, such as 0.1 mm of a locator,
10 % of a clamp force or one standard deviation of a source, by exact derivatives, contact and friction included.
"""

import mic
from mic import examples
from mic.report import pictures

model = mic.reduce(mic.load_scene(examples.folder("lap_joint")))
sensitivities = mic.sensitivity(model, "coulomb", samples=10)

# %%
# Effects at the mean assembly and their range over ten samples, µm; and the distance of the mean assembly from the
# nearest change of a contact state, beyond which the derivatives change.
largest = sensitivities.table.assign(size=sensitivities.table["effect"].abs()).nlargest(6, "size")
effects = largest[["measurement", "input", "step", "effect", "effect_low", "effect_high"]]
print(
    effects.assign(**{name: 1e3 * effects[name] for name in effects if "effect" in name})
    .round(2)
    .to_string(index=False)
)
print(f"The mean assembly is {sensitivities.reach:.2g} σ from the next change: {sensitivities.where}")

# %%
# The picture of the report.
(steps,) = pictures(sensitivities)
steps
