"""Cells that vary all parameters at once: points of a Sobol sequence.

Three families with known solutions: a strip bent onto a stop, a sheet on an incline, and a contact problem constructed
from its solution. Choices take their values with equal frequency; other parameters are distributed evenly in their
logarithm. If a cell is refused, the remedy of its message is applied (:data:`REMEDIES`) and the cell is tried again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from mic.contact import ContactSolver, Friction
from mic.contact.laws import find
from mic.geometry.structured import extrude
from mic.scene import Locator
from mic.scene.zone import MOST
from verification import strips
from verification.analytic.sheet import Sheet, incline_reaction, stop_force
from verification.contact_problems import compliant, manufactured

__all__ = ["FAMILIES", "REMEDIES", "Cell", "Family", "cells", "remedied"]


@dataclass(frozen=True)
class Decades:
    """Values from `low` to `high`, evenly spread in their logarithm; a `share` of the cells takes `else_` instead."""

    low: float
    high: float
    share: float = 0.0
    else_: float = 0.0

    def __call__(self, at: float) -> float:
        if at < self.share:
            return self.else_
        at = (at - self.share) / (1 - self.share)
        return float(self.low * (self.high / self.low) ** at)


@dataclass(frozen=True)
class Choice:
    """One of several values, with equal frequency."""

    values: tuple

    def __call__(self, at: float):
        return self.values[min(int(at * len(self.values)), len(self.values) - 1)]


@dataclass(frozen=True)
class Family:
    """Cells of one kind.

    Attributes
    ----------
    axes : dict
        Parameters of the design, by name.
    error : callable
        ``error(context, values)`` of a cell.
    right : float
        Largest error that counts as right.
    cells, quick : int
        Number of cells in the full and in the quick version; powers of two, as a Sobol sequence requires.
    """

    axes: dict[str, Callable[[float], object]]
    error: Callable
    right: float
    cells: int
    quick: int


@dataclass(frozen=True)
class Cell:
    """A family's name, the cell's number in its design, and its values by axis."""

    family: str
    number: int
    values: dict


def cells(quick: bool) -> list[Cell]:
    """All cells of all families."""
    made = []
    for name, family in FAMILIES.items():
        count = family.quick if quick else family.cells
        design = qmc.Sobol(len(family.axes), seed=len(name)).random(count)
        for i, row in enumerate(design):
            values = {axis: read(at) for (axis, read), at in zip(family.axes.items(), row)}
            made.append(Cell(name, i, values))
    return made


# --- a strip bent onto a stop
# ------------------------------------------------------------------------------------------------------


def strip(context, values: dict) -> float:
    """Error of the force on the stop, over the load."""
    length, force = values["unit of length"], values["unit of force"]
    L = 200.0 * length
    sheet = Sheet(
        length=L,
        width=10 * length,
        depth=values["t/L"] * L,
        size=values["element size / width"] * 10 * length,
        young=values["E"] * force / length**2,
        friction=values["friction"],
    )
    gap = values["gap / L"] * L
    bending = sheet.young * sheet.width * sheet.depth**3 / 12
    load = values["load / closing load"] * 48 * bending * gap / L**3

    def alter(scene):
        scene = _stages(
            _twins(_sliver(scene, sheet, values["sliver"]), values["pairs apart"] * length), values["stages"]
        )
        locators = [
            Locator(**(locator.model_dump() | {"name": f"{locator.name}-{i}"}))
            for locator in scene.locators
            for i in range(values["locators given"] - 1)
        ]
        report = scene.report.model_copy(update={"laws": [values["law"]]})
        return scene.model_copy(update={"locators": scene.locators + locators, "report": report})

    found, exact = stop_force(sheet, context, load, gap, alter)
    return abs(found - exact) / load


def _sliver(scene, sheet, narrow):
    if narrow == 1:
        return scene
    points, triangles, _ = extrude([(0.0, 0.0), (sheet.width, 0.0)], 0.0, sheet.length, sheet.size)
    near = np.abs(points[:, 0] - (sheet.length / 2 + sheet.size)) < 1e-9 * sheet.length
    points[near, 0] = sheet.length / 2 + narrow * sheet.size
    mesh = strips.write_mesh(scene.folder, points, triangles)
    return scene.model_copy(update={"parts": [part.model_copy(update={"mesh": mesh}) for part in scene.parts]})


def _twins(scene, apart):
    if apart < 0:
        return scene
    x, y, z = scene.zones[0].points[0]
    change = {"points": [(x - apart / 2, y, z), (x + apart / 2, y, z)], "patch": 0.0}
    return scene.model_copy(update={"zones": [scene.zones[0].model_copy(update=change)]})


def _stages(scene, count):
    """The load divided over several equal stages, the last with the original name."""
    if count == 1:
        return scene
    stages, clamps = [], []
    for stage in scene.stages:
        if stage.kind != "clamp":
            stages.append(stage)
            continue
        for k in range(count):
            last = k == count - 1
            name = stage.name if last else f"{stage.name}-{k}"
            own = [
                clamp.model_copy(
                    update={
                        "name": clamp.name if last else f"{clamp.name}-{k}",
                        "force": clamp.force / count,
                        "stage": name,
                    }
                )
                for clamp in scene.clamps
            ]
            clamps += own
            order = [[clamp.name for clamp in own]]
            stages.append(stage.model_copy(update={"name": name, "order": order}))
    return scene.model_copy(update={"stages": stages, "clamps": clamps})


# --- a sheet on an incline
# ------------------------------------------------------------------------------------------------------


def incline(context, values: dict) -> float:
    """Error of the force on the stop below, over the weight."""
    length, force = values["unit of length"], values["unit of force"]
    sheet = Sheet(
        length=40.0 * length,
        width=40.0 * length,
        depth=values["t/L"] * 40 * length,
        size=5.0 * length,
        columns=values["columns"],
        young=values["E"] * force / length**2,
        friction=values["friction"],
        pressure=values["pressure / E"] * values["E"] * force / length**2,
    )
    found, exact = incline_reaction(sheet, context, values["slope"])
    return abs(found - exact)


# --- a contact problem constructed from its solution
# ------------------------------------------------------------------------------------------------------


def contacts(context, values: dict) -> float:
    """Largest relative violation of the law over four samples, computed independently of the solver's certificate."""
    rng = np.random.default_rng(values["seed"])
    m = round(values["contacts"])
    first, second = (compliant(m, rng, values["condition"], values["tangential"]) for _ in range(2))
    S = values["compliance"] * (first + second / values["E : E"])
    mu, law = np.full(m, values["friction"]), find(values["law"])
    problem = manufactured(S, mu, 4, rng, stick=0.4 * values["stuck"], slide=0.4 * (1 - values["stuck"]), law=law)
    series = np.zeros(m)
    force, shift = problem.force.reshape(-1, m, 3), problem.displacement.reshape(-1, m, 3).copy()
    if law.name == "micro-slip":
        series = values["yield"] * S.diagonal().reshape(m, 3)[:, 1:].mean(1)
        shift[..., 1:] -= series[:, None] * force[..., 1:]
    b = values["load"] * (shift.reshape(4, -1) - problem.force @ S)
    solution = ContactSolver(S, Friction(mu, None, series), law).solve(b)
    if not solution.converged.all():
        raise ArithmeticError(
            f"{(~solution.converged).sum()} of 4 samples did not converge and say so (residual "
            f"{solution.residual.max():.1e})"
        )
    f, u = solution.force.reshape(-1, m, 3), (solution.force @ S + b).reshape(-1, m, 3)
    slider = u[..., 1:] + series[:, None] * f[..., 1:]
    slip, traction = np.linalg.norm(slider, axis=-1), np.linalg.norm(f[..., 1:], axis=-1)
    opening = u[..., 0] - (1 - law.shift) * mu * slip
    tiny = np.finfo(float).tiny
    long, cone = np.abs(b).max(), mu * f[..., 0]
    high = max(np.abs(f).max(), tiny / long)  # no contact closed in any sample: all forces must be zero
    errors = [
        (-opening).max() / long,
        (traction - cone).max() / high,
        np.abs(f[..., 0] * opening).max() / (high * long),
        np.abs(cone * slip + (f[..., 1:] * slider).sum(-1)).max() / (high * long),
    ]
    return float(np.max(errors))  # NaN, if one is


FRICTION = Decades(1e-6, MOST, share=0.1)  # scenes refuse more; contact problems without a scene do not
UNIT = Decades(1e-3, 1e3, share=0.25, else_=1.0)
FAMILIES: dict[str, Family] = {
    "strip on a stop": Family(
        {
            "t/L": Decades(1e-5, 1e-1),
            "E": Decades(1.0, 1e7),
            "friction": FRICTION,
            "gap / L": Decades(1e-11, 0.5),
            "load / closing load": Decades(0.1, 100.0),
            "element size / width": Choice((1.0, 0.5, 0.25)),
            "sliver": Decades(1e-8, 0.5, share=0.5, else_=1.0),
            "pairs apart": Decades(1e-9, 0.5, share=0.6, else_=-1.0),
            "locators given": Choice((1, 2, 3, 4)),
            "stages": Choice((1, 2, 3)),
            "law": Choice(("coulomb", "frictionless")),  # the associated law opens sliding contacts
            "unit of length": UNIT,
            "unit of force": UNIT,
        },
        strip,
        0.005,
        128,
        32,
    ),
    "sheet on an incline": Family(
        {
            "t/L": Decades(1e-4, 1e-1),
            "E": Decades(1.0, 1e7),
            "friction": FRICTION,
            "slope": Decades(1e-3, 1.5),
            "pressure / E": Decades(1e-12, 1e-3),
            "columns": Choice((2, 4, 8)),
            "unit of length": UNIT,
            "unit of force": UNIT,
        },
        incline,
        1e-3,
        64,
        16,
    ),
    "contact problem": Family(
        {
            "contacts": Decades(1.0, 200.0),
            "friction": Decades(1e-6, 1e3, share=0.1),
            "compliance": Decades(1e-12, 1e6),
            "load": Decades(1e-9, 1e9),
            "condition": Decades(1e1, 1e8),
            "tangential": Decades(1e-2, 1e2),
            "E : E": Decades(1e-4, 1e4),
            "stuck": Decades(1e-2, 1.0),
            "yield": Decades(1e-3, 1e3),
            "law": Choice(("coulomb", "associated", "micro-slip")),
            "seed": Choice(tuple(range(1000))),
        },
        contacts,
        1e-6,
        256,
        64,
    ),
}


# --- remedies
# ------------------------------------------------------------------------------------------------------

#: Remedies of messages, or of the documentation (`docs/contact.md` for friction of 10 and more): a part of the message,
#: and the change of the cell's parameters.
REMEDIES: dict[str, Callable[[dict], dict]] = {
    "elements that are too narrow": lambda values: {"sliver": 1.0},
    "did not converge": lambda values: {"friction": min(values["friction"], 5.0)},
}


def remedied(cell: Cell, reason: str) -> Cell | None:
    """The cell with the remedy of its refusal applied; None if the message contains no known remedy."""
    for text, change in REMEDIES.items():
        if text in reason:
            return replace(cell, values=cell.values | change(cell.values))
    return None
