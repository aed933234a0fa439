"""
Wheelhouse
==========

Inner and outer wheelhouse with three contact zones along the arch: a synthetic assembly similar to the paper's, on a
coarse mesh.
"""

import tempfile
from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt

import mic
from mic import examples, runs
from mic.report.context import read_context
from mic.report.picture_registry import draw

scene = mic.load_scene(examples.folder("wheelhouse"))
scene = scene.model_copy(
    update={
        "parts": [part.model_copy(update={"size": "coarse"}) for part in scene.parts],
        "monte_carlo": scene.monte_carlo.model_copy(update={"samples": 50}),
        "report": scene.report.model_copy(update={"laws": ["coulomb"], "fields": True}),
    }
)

# %%
# Fifty assemblies, written into a results folder as by ``mic run``, and the overview of the report: scatter of the
# surfaces after release, contact pairs and welds.
with tempfile.TemporaryDirectory() as folder:
    outcome = runs.run(scene, Path(folder), mic.cache_folder())
    picture = draw("overview", outcome, read_context(outcome))

figure, axis = plt.subplots(figsize=(9, 5.4), layout="constrained")
axis.imshow(plt.imread(BytesIO(picture.data)))
axis.set_axis_off()
plt.show()

# %%
# Contact forces of the nominal assembly after clamping: the evenly spread pairs transmit force under the clamps only.
# ``table1.toml`` beside the scene has pairs where the clamps press, and comes nearest to the paper's Table 1.
model = outcome.model
evaluation = model.evaluate(dict.fromkeys(model.parameters, 0.0))
force = evaluation.resolutions["clamp"].force[0, :, 0]
x, _, z = model.contacts.point.T
figure, axis = plt.subplots(figsize=(9, 3.8), layout="constrained")
dots = axis.scatter(x, z, c=force, s=25, cmap="viridis")
axis.set(xlabel="x (mm)", ylabel="z (mm)", aspect="equal")
figure.colorbar(dots, label="normal force (N)")
plt.show()
