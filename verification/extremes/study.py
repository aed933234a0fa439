"""Range of sizes, materials, gaps and meshes with right results, and whether the program refuses the others."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.patches import Rectangle

from fem_reference.shell.factorisation import FactorisationError
from mic.contact import ContactSolver
from mic.geometry.structured import extrude
from mic.scene import Locator, SceneError
from mic.scene.zone import MOST
from verification import strips
from verification.analytic.sheet import Sheet, incline_reaction, stop_force
from verification.contact_problems import compliant, manufactured
from verification.extremes import design
from verification.plots import panels
from verification.study import Acceptance, Finding, Study

REFUSALS = (SceneError, FactorisationError, ValueError, ArithmeticError)
RIGHT = 0.005  # largest relative error of a right result: the meshes are coarse
EXACT = 1e-6  # the same for contact problems with a manufactured solution


def bent_onto_stop(context, sheet, gap=0.1, alter=lambda scene: scene):
    """Relative error of the force on a stop, under twice the load that closes the gap."""
    bending = sheet.young * sheet.width * sheet.depth**3 / 12
    load = 2 * 48 * bending * gap / sheet.length**3
    found, exact = stop_force(sheet, context, load, gap, alter)
    return abs(found / exact - 1)


def slender(context, young, slenderness):
    """Thickness over length, and Young's modulus."""
    sheet = Sheet(size=5.0, young=young)
    return bent_onto_stop(context, replace(sheet, depth=slenderness * sheet.length))


def gap(context, value):
    """Gap that must close, mm."""
    return bent_onto_stop(context, Sheet(size=5.0), value)


def friction(context, value):
    """Coefficient of friction on an incline."""
    found, exact = incline_reaction(Sheet(length=40.0, width=40.0, size=5.0, columns=8, friction=value), context, 0.6)
    return abs(found - exact)


def sliver(context, value):
    """Columns of elements narrower than the others by this factor, where the strip is loaded and stopped."""
    sheet = Sheet(size=5.0)

    def alter(scene):
        points, triangles, _ = extrude([(0.0, 0.0), (sheet.width, 0.0)], 0.0, sheet.length, sheet.size)
        near = np.abs(points[:, 0] - (sheet.length / 2 + sheet.size)) < 1e-9
        points[near, 0] = sheet.length / 2 + value * sheet.size
        mesh = strips.write_mesh(scene.folder, points, triangles)
        return scene.model_copy(update={"parts": [part.model_copy(update={"mesh": mesh}) for part in scene.parts]})

    return bent_onto_stop(context, sheet, alter=alter)


def coincident(context, value):
    """Two contact pairs at this distance (mm), as nodal functionals."""
    sheet = Sheet(size=5.0)

    def alter(scene):
        x, y, z = scene.zones[0].points[0]
        zone = scene.zones[0].model_copy(
            update={"points": [(x - value / 2, y, z), (x + value / 2, y, z)], "patch": 0.0}
        )
        return scene.model_copy(update={"zones": [zone]})

    return bent_onto_stop(context, sheet, alter=alter)


def redundant(context, value):
    """Each locator repeated this many times."""

    def alter(scene):
        more = [
            Locator(**(locator.model_dump() | {"name": f"{locator.name}-{i}"}))
            for locator in scene.locators
            for i in range(int(value) - 1)
        ]
        return scene.model_copy(update={"locators": scene.locators + more})

    return bent_onto_stop(context, Sheet(size=5.0), alter=alter)


UNITS = {
    "mm, N": (1.0, 1.0),
    "m, N": (1e-3, 1.0),
    "m, kN": (1e-3, 1e-3),
    "µm, mN": (1e3, 1e3),
    "inch, lbf": (1 / 25.4, 1 / 4.4482216),
}


def units(context, name):
    """The same strip in other consistent units of length and force."""
    length, force = UNITS[name]
    sheet = Sheet(
        length=200 * length, width=10 * length, depth=length, size=5 * length, young=210e3 * force / length**2
    )
    return bent_onto_stop(context, sheet, 0.1 * length)


def unequal(context, value):
    """Two contacting parts whose moduli differ by this factor, as a contact problem: compliances of both sides
    added."""
    rng = np.random.default_rng(5)
    soft, stiff = compliant(40, rng, 1e3), compliant(40, rng, 1e3)
    return manufactured_error(lambda: soft + stiff / value, np.full(40, 0.3))


def contacts(context, value):
    """Number of contacts."""
    rng = np.random.default_rng(int(value))
    points = rng.random((int(value), 2)) * np.sqrt(value)
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    return manufactured_error(
        lambda: np.kron(np.exp(-distance) + 0.1 * np.eye(int(value)), np.eye(3)), np.full(int(value), 0.3)
    )


def scaled(context, mu, scale):
    """Coefficient of friction, and compliance in units far from mm/N, as a contact problem."""
    return manufactured_error(lambda: scale * compliant(40, np.random.default_rng(7), 1e3), np.full(40, mu))


def manufactured_error(compliance, mu):
    """Largest relative violation of Coulomb's law over four samples: gap, cone, complementarity and slip direction.

    The check is independent of the solver. The compliance is generated twice to save memory, of which it takes most for
    3000 contacts.
    """
    problem = manufactured(compliance(), mu, 4, np.random.default_rng(11))
    solver, b = ContactSolver(problem.S, problem.mu), problem.b
    del problem
    solution = solver.solve(b)
    del solver
    if not solution.converged.all():
        raise ArithmeticError(
            f"{(~solution.converged).sum()} of 4 samples did not converge and say so (residual "
            f"{solution.residual.max():.1e})"
        )
    m = len(mu)
    f, u = solution.force.reshape(-1, m, 3), (solution.force @ compliance() + b).reshape(-1, m, 3)
    force, length = np.abs(f).max(), np.abs(b).max()
    traction, slip = np.linalg.norm(f[..., 1:], axis=-1), np.linalg.norm(u[..., 1:], axis=-1)
    cone = mu * f[..., 0]
    return float(
        max(
            (-u[..., 0]).max() / length,
            (traction - cone).max() / force,
            np.abs(f[..., 0] * u[..., 0]).max() / (force * length),
            np.abs(cone * slip + (f[..., 1:] * u[..., 1:]).sum(-1)).max() / (force * length),
        )
    )


def sweeps(quick):
    """Name of each sweep, function of its cells, their values, and the largest error that counts as right."""
    moduli = (1.0, 1e7) if quick else (1.0, 1e3, 210e3, 1e7)
    slendernesses = (1e-5, 1e-3, 1e-1) if quick else (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
    rows = [
        (f"t/L, E = {young:g} MPa", lambda c, v, young=young: slender(c, young, v), slendernesses, RIGHT)
        for young in moduli
    ]
    rows += [
        ("gap, mm", gap, (1e-9, 1e-3, 1e2) if quick else (1e-9, 1e-6, 1e-3, 1e-1, 1.0, 1e2), RIGHT),
        ("friction", friction, (0.0, 0.3, MOST) if quick else (0.0, 1e-6, 1e-2, 0.3, 1.0, 3.0, MOST), 1e-3),
        (
            "sliver width / size",
            sliver,
            (1e-2, 1e-5, 1e-8) if quick else (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8),
            RIGHT,
        ),
        ("pairs apart, mm", coincident, (1.0, 1e-6, 0.0) if quick else (5.0, 1.0, 1e-2, 1e-4, 1e-6, 1e-9, 0.0), RIGHT),
        ("locators given … times", redundant, (2, 5) if quick else (1, 2, 3, 5), RIGHT),
        ("units", units, tuple(UNITS)[:3] if quick else tuple(UNITS), RIGHT),
        ("E : E", unequal, (1.0, 1e4) if quick else (1e-4, 1e-2, 1.0, 1e2, 1e4), EXACT),
        ("contacts", contacts, (1, 10, 100, 300) if quick else (1, 3, 10, 30, 100, 300, 1000, 3000), EXACT),
    ]
    for scale in (1e-9, 1e6):
        rows.append(
            (
                f"friction, S × {scale:g}",
                lambda c, v, scale=scale: scaled(c, v, scale),
                (0.0, 0.3, 1e3) if quick else (0.0, 1e-3, 0.1, 0.3, 1.0, 10.0, 1e3),
                EXACT,
            )
        )
    return rows


def attempt(context, name, function, value, right):
    """One cell: right, refused with a reason, or wrong."""
    try:
        error = float(function(context, value))
    except REFUSALS as refusal:
        reason = " ".join(str(refusal).split())
        return {
            "sweep": name,
            "value": value,
            "error": np.nan,
            "outcome": "refused" if len(reason) > 20 else "wrong",
            "reason": reason,
        }
    outcome = "right" if error <= right else "wrong"  # NaN is wrong
    return {"sweep": name, "value": value, "error": error, "outcome": outcome, "reason": ""}


def heat_map(table):
    """Figure with a row for each sweep; colour shows the outcome, text the error."""
    names = list(dict.fromkeys(table["sweep"]))
    colours = {"right": "#bfe3c7", "refused": "#f3e2a9", "wrong": "#e98b80"}
    figure, (axis,) = panels(1, width=9.5, height=0.42 * len(names) + 0.8)
    for row, name in enumerate(names):
        for column, (_, cell) in enumerate(table[table["sweep"] == name].iterrows()):
            axis.add_patch(tile(column, row, colours[cell["outcome"]]))
            value = cell["value"] if isinstance(cell["value"], str) else f"{cell['value']:g}"
            second = "refused" if cell["outcome"] == "refused" else f"{cell['error']:.0e}"
            axis.text(column + 0.5, row + 0.32, value, ha="center", va="center", fontsize=8.5)
            axis.text(column + 0.5, row + 0.7, second, ha="center", va="center", fontsize=7.5, color="0.3")
    axis.set(
        xlim=(0, table.groupby("sweep").size().max()),
        ylim=(len(names), 0),
        xticks=[],
        yticks=np.arange(len(names)) + 0.5,
    )
    axis.set_yticklabels(names)
    axis.grid(False)
    handles = [tile(0, 0, colour) for colour in colours.values()]
    axis.legend(handles, colours, ncols=3, loc="lower right", bbox_to_anchor=(1, 1))
    return figure


def tile(x, y, colour):
    """A square of the map, its left upper corner at (x, y)."""
    return Rectangle((x + 0.02, y + 0.03), 0.96, 0.94, facecolor=colour, edgecolor="none")


def try_drawn(context, cell):
    """Outcome of a random cell. If it is refused, remedies are applied in turn, until a remedy changes nothing."""
    family = design.FAMILIES[cell.family]

    def solve(one):
        return attempt(context, one.family, family.error, one.values, family.right)

    outcome = solve(cell)
    row = {"family": cell.family, "cell": cell.number} | {key: outcome[key] for key in ("error", "outcome", "reason")}
    if outcome["outcome"] != "refused":
        return row
    while outcome["outcome"] == "refused":
        changed = design.remedied(cell, outcome["reason"])
        if changed is None or changed == cell:
            return row | {"with its remedy": "refused"}
        cell, outcome = changed, solve(changed)
    return row | {"with its remedy": outcome["outcome"]}


def drawn(rows):
    """Findings on the cells that vary all parameters at once."""
    table = pd.DataFrame(rows, columns=["family", "cell", "outcome", "error", "reason", "with its remedy"])
    refused = table[table["outcome"] == "refused"].drop(columns=["outcome", "error"])
    worked = (refused["with its remedy"] == "right").mean() if len(refused) else 1.0
    said = ", ".join(f"{n} {kind}" for kind, n in table["outcome"].value_counts().items())
    wrong = table[table["outcome"] == "wrong"].drop(columns=["outcome", "with its remedy"])
    return [
        Finding("drawn-wrong", len(wrong), f"{len(table)} cells: {said}.", table=wrong if len(wrong) else None),
        Finding("drawn-refused", len(refused) / len(table), table=refused if len(refused) else None),
        Finding("remedies", float(worked), f"{len(refused)} refusals."),
    ]


def run(context):
    cells = [
        (name, function, value, right) for name, function, values, right in sweeps(context.quick) for value in values
    ]
    # The problem with the most contacts, the last of its sweep, takes half of the time and so starts first.
    tasks = [partial(attempt, context, *cell) for cell in cells]
    order = sorted(range(len(cells)), key=lambda i: -cells[i][2] if cells[i][1] is contacts else 0)
    tasks = [tasks[i] for i in order] + [partial(try_drawn, context, cell) for cell in design.cells(context.quick)]
    found = context.team.map(lambda task: task(), tasks)
    table = pd.DataFrame([found[order.index(i)] for i in range(len(cells))])
    outcome = table["outcome"].value_counts()
    refused = table[table["outcome"] == "refused"][["sweep", "value", "reason"]]
    return [
        Finding(
            "wrong",
            int(outcome.get("wrong", 0)),
            f"{len(table)} cells: "
            + ", ".join(f"{n} {kind}" for kind, n in outcome.items())
            + ". Each shows the value (above) and the error (below).",
            heat_map(table),
            table.drop(columns="reason"),
        ),
        Finding("refused", int(outcome.get("refused", 0)) / len(table), table=refused if len(refused) else None),
        *drawn(found[len(cells) :]),
    ]


STUDY = Study(
    order=90,
    title="Extremes",
    claim=(
        "At extremes of size, material, friction, gap, mesh and units an answer is right, or refused with a reason. "
        "None is silently wrong."
    ),
    reference=(
        "Closed forms (strip on a stop, sheet on an incline) and manufactured contact solutions, judged by an "
        "independent check of Coulomb's law."
    ),
    acceptance=(
        Acceptance(
            "wrong",
            "Number of cells whose answer is wrong without a message.",
            0,
            reason="A silent wrong answer must not happen.",
        ),
        Acceptance(
            "refused",
            "Share of refused cells.",
            0.03,
            quick=0.071,
            reason=(
                "More than one in thirty would not be an exception (quick: as many of 35 cells as of 83, since the "
                "ends of each sweep stay)."
            ),
        ),
        Acceptance(
            "drawn-wrong",
            "Number of randomly drawn cells that are silently wrong.",
            0,
            reason="A silent wrong answer must not happen.",
        ),
        Acceptance(
            "drawn-refused",
            "Share of randomly drawn cells that are refused.",
            0.03,
            reason="More than one in thirty would not be an exception.",
        ),
        Acceptance(
            "remedies",
            "Share of refused cells that are right after the advised remedy.",
            1.0,
            bound="at least",
            reason="A remedy must work.",
        ),
    ),
    seconds=(210, 22),
    judges_accuracy=False,
    memory=3.8,
    run=run,
)
