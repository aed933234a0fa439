"""Published benchmarks of contact with friction, solved by the contact solver of the program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from verification.mesh.study import converge
from verification.plots import panels
from verification.published import cases
from verification.study import Acceptance, Finding, Study
from verification.validation import COVERAGE, Uncertainty

#: Published values, mm: code_aster's command files ssnp154a-d and ssna122a-b, by order of their elements and friction.
ROLLER = {(1, 0.0): -1.30690, (1, 0.1): -1.30108, (2, 0.0): -1.30802, (2, 0.1): -1.30264}
PUNCH = {(1, 0.0): -0.1307341, (1, 0.1): -0.1285802, (2, 0.0): -0.1329412, (2, 0.1): -0.1307935}


#: Relative 95 % uncertainty of published values: what closed forms neglect, the scatter of codes that the source
#: allows, or the difference of published meshes of linear and quadratic elements.
REFERENCE = {
    "plate": 0.05,
    "hertz": 0.015,
    "cattaneo": 0.007,
    "roller": max(abs(ROLLER[1, mu] / ROLLER[2, mu] - 1) for mu in (0.0, 0.1)),
    "punch": max(abs(PUNCH[1, mu] / PUNCH[2, mu] - 1) for mu in (0.0, 0.1)),
    "punch-friction": abs((PUNCH[1, 0.1] - PUNCH[1, 0.0]) / (PUNCH[2, 0.1] - PUNCH[2, 0.0]) - 1),
}


@dataclass(frozen=True)
class Measured:
    """A quantity on three meshes, and its published value.

    Attributes
    ----------
    name, quantity : str
        Name of the acceptance limit, and description.
    published : float
    values : tuple of three float
        From coarse to fine.
    scale : float or None
        Reference of relative errors; default: the published value.
    """

    name: str
    quantity: str
    published: float
    values: tuple[float, float, float]
    scale: float | None = None

    @property
    def size(self) -> float:
        """Reference of relative errors."""
        return abs(self.published if self.scale is None else self.scale)

    @property
    def error(self) -> float:
        """Relative error on the finest mesh."""
        return abs(self.values[2] - self.published) / self.size

    @property
    def own(self) -> float:
        """Mesh error of the finest mesh, estimated from three meshes."""
        return converge((4.0, 2.0, 1.0), self.values).index / self.size


def shoe():
    """SSNV503."""
    found = np.array([cases.shoe(divisions=n) for n in (2, 4, 8)])
    exact = cases.rigid_shoe()
    made = []
    for k, load in enumerate(("pressed", "pushed below the slip force", "pushed above it")):
        for j, (what, name, scale) in enumerate(
            (
                ("normal force, N", "shoe-force", 12000.0),
                ("friction force, N", "shoe-force", 3600.0),
                ("normal displacement, mm", "shoe", 9.0),
                ("displacement along the plane, mm", "shoe", 9.0),
            )
        ):
            made.append(Measured(name, f"{load}: {what}", exact[k, j], tuple(found[:, k, j]), scale))
    return made


def plate():
    """SSNV128."""
    found = np.array([cases.plate(n) for n in (16, 32, 64)])
    return [
        Measured("plate", f"displacement along the plane at x = {x:g} mm, mm", value, tuple(found[:, i]))
        for i, (x, value) in enumerate(cases.PLATE.items())
    ]


def roller():
    """SSNP154."""
    runs = [cases.Roller(h) for h in (0.5, 0.25, 0.125)]
    free, held = ([run.solve(mu) for run in runs] for mu in (0.0, 0.1))
    a, p = runs[0].hertz
    return [
        Measured("hertz", "half width of the contact, mm", a, tuple(x[1] for x in free)),
        Measured("hertz", "largest pressure, MPa", p, tuple(x[2] for x in free)),
        Measured("roller", "top of the block, μ = 0, mm", ROLLER[2, 0.0], tuple(x[0] for x in free)),
        Measured("roller", "top of the block, μ = 0.1, mm", ROLLER[2, 0.1], tuple(x[0] for x in held)),
    ]


def punch():
    """SSNA122."""
    runs = [cases.Punch(h) for h in (4.0, 2.0, 1.0)]
    free, held = (np.array([run.solve(mu) for run in runs]) for mu in (0.0, 0.1))
    return [
        Measured("punch", "middle of the face, μ = 0, mm", PUNCH[2, 0.0], tuple(free)),
        Measured("punch", "middle of the face, μ = 0.1, mm", PUNCH[2, 0.1], tuple(held)),
        Measured("punch-friction", "their difference, mm", PUNCH[2, 0.1] - PUNCH[2, 0.0], tuple(held - free)),
    ]


def cattaneo():
    """Two cylinders, pressed and then sheared; the half width of stick by the second moment of the traction."""
    found = []
    for n in (8, 16, 32):
        sheared, a, c = cases.cattaneo(n)
        moment = 4 * (sheared.tangential * sheared.x**2).sum() / 0.3
        own = sheared.half_width
        found.append(
            (own, float(np.abs((sheared.normal.sum() * own**2 - moment) * own**2 / sheared.normal.sum()) ** 0.25))
        )
    wide, stuck = zip(*found)
    return [
        Measured("cattaneo", "half width of the contact, mm", a, wide),
        Measured("cattaneo", "half width of the part that sticks, mm", c, stuck),
    ]


CASES = {"SSNP154": roller, "SSNA122": punch, "SSNV503": shoe, "SSNV128": plate, "Cattaneo and Mindlin": cattaneo}
QUICK = ("SSNV503", "SSNV128", "Cattaneo and Mindlin")


def traction_figure():
    """Figure of the tractions of the sheared cylinders and of those by Cattaneo and Mindlin."""
    sheared, a, c = cases.cattaneo(16)
    cell = np.gradient(sheared.x)
    weight = np.where(np.arange(len(cell)) % 2, 4, 2) / 3 * cell  # midpoints of edges carry twice the force of corners
    figure, (axis,) = panels(1)
    fine = np.linspace(-1.2 * a, 1.2 * a, 400)

    def root(x, r):
        return np.sqrt(np.maximum(1 - (x / r) ** 2, 0))

    top = 2 * sheared.normal.sum() / (np.pi * a)
    axis.plot(fine, top * root(fine, a), "k-", lw=1, label="Hertz")
    axis.plot(fine, top * 0.3 * (root(fine, a) - c / a * root(fine, c)), "k--", lw=1, label="Cattaneo and Mindlin")
    axis.plot(sheared.x, sheared.normal / weight, "o", color="tab:red", ms=3, label="pressure")
    axis.plot(sheared.x, sheared.tangential / weight, "o", color="tab:blue", ms=3, label="shear traction")
    axis.set(xlabel="x, mm", ylabel="traction, MPa", xlim=(-1.2 * a, 1.2 * a), ylim=(0, 1.1 * top))
    axis.legend()
    return figure


def run(context):
    cases = [case for name, case in CASES.items() if not context.quick or name in QUICK]
    found = [one for made in context.team.map(lambda case: case(), cases) for one in made]
    limits = {item.name: item.limit for item in STUDY.acceptance}
    rows = [
        {
            "number": one.name,
            "quantity": one.quantity,
            "published": one.published,
            "coarse": one.values[0],
            "medium": one.values[1],
            "fine": one.values[2],
            "difference": one.error,
            "of it the mesh's": one.own,
        }
        for one in found
    ]
    table = pd.DataFrame(rows)
    made = []
    for name in dict.fromkeys(one.name for one in found):
        own = [one for one in found if one.name == name]
        figure = traction_figure() if name == "cattaneo" else None
        part, worst = table[table["number"] == name].drop(columns="number"), max(own, key=lambda one: one.error)
        uncertainty = Uncertainty(num=worst.own / COVERAGE, reference=REFERENCE.get(name, 0.0) / COVERAGE)
        made.append(Finding(name, worst.error, NOTES.get(name, ""), figure, part, uncertainty))
    return [*made, Finding("own", max(one.own / limits[one.name] for one in found))]


NOTES = {
    "roller": f"Published with linear elements {ROLLER[1, 0.0]:g} and {ROLLER[1, 0.1]:g} mm, with quadratic ones, "
    f"used here, {ROLLER[2, 0.0]:g} and {ROLLER[2, 0.1]:g} mm, all with large displacements.",
    "punch": f"Published with linear elements {PUNCH[1, 0.0]:g} and {PUNCH[1, 0.1]:g} mm, with quadratic ones, "
    f"used here, {PUNCH[2, 0.0]:g} and {PUNCH[2, 0.1]:g} mm: the finer, the softer.",
}

STUDY = Study(
    order=82,
    title="Published benchmarks",
    claim=(
        "The contact solver, given the compliance of bodies that are no sheets, reproduces published results: stick, "
        "slip, partial slip, growing contact."
    ),
    reference=(
        "code_aster's validation cases SSNV503 (closed form), SSNV128 (average of codes), SSNP154 and SSNA122 "
        "(NAFEMS contact benchmarks 1 and 2); Hertz, Cattaneo and Mindlin. Each on three meshes of quadratic "
        "triangles."
    ),
    acceptance=(
        Acceptance(
            "shoe",
            "SSNV503, a shoe on a plane: largest error of its displacements over the 9 mm of sliding.",
            0.004,
            reason="The closed form neglects the shoe's compliance: 0.035 of 9 mm.",
        ),
        Acceptance(
            "shoe-force",
            "SSNV503: largest error of normal and friction force over 12 000 and 3600 N.",
            4e-5,
            reason="The closed form neglects the shoe's compliance: 0.14 N of 3600 N.",
        ),
        Acceptance(
            "plate",
            "SSNV128, a plate pressed and pushed along a plane: largest relative error of its motion.",
            0.05,
            reason="The 5 % that the source allows its own codes.",
        ),
        Acceptance(
            "hertz",
            "SSNP154, a roller on a block: relative error of Hertz's half width and pressure.",
            0.015,
            reason="The half-space neglects (a/R)² = 0.015.",
            full_only=True,
        ),
        Acceptance(
            "roller",
            "SSNP154: relative error of the displacement of the block's top.",
            0.027,
            reason="The reference has large displacements; Hertz's largest strain is 2.7 %.",
            full_only=True,
        ),
        Acceptance(
            "punch",
            "SSNA122, a punch with a rounded edge: relative error of the displacement below it.",
            0.017,
            reason="The difference of the two published meshes.",
            full_only=True,
        ),
        Acceptance(
            "punch-friction",
            "SSNA122: relative error of friction's effect on that displacement.",
            0.003,
            reason="The difference of the two published meshes, 0.3 %.",
            full_only=True,
        ),
        Acceptance(
            "cattaneo",
            "Cylinders pressed and sheared: relative error of the half widths of contact and stick.",
            0.007,
            reason="The half-space neglects (a/R)² = 0.007.",
        ),
        Acceptance(
            "own",
            "Mesh error of each of these numbers, over its limit.",
            0.2,
            reason="A reference errs by at most a fifth of the limit.",
        ),
    ),
    seconds=(33, 4),
    memory=1.1,
    run=run,
)
