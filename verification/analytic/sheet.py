"""One sheet on a rigid flat base: sliding down an incline, dragged along with partial slip, bent down onto a stop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.model.assembly import assemble
from verification import strips

__all__ = ["Sheet", "dragged_ends", "incline_reaction", "stop_force"]


@dataclass(frozen=True)
class Sheet:
    """Sizes and loads of the sheet.

    Attributes
    ----------
    length, width, depth : float
        mm.
    young : float
        MPa; Poisson's ratio is 0, so that a strip is a bar and a beam.
    friction : float
    pressure : float
        MPa, with which the sheet is pressed on the base.
    size : float
        Element size, mm.
    columns : int
        Contact pairs along the sheet.
    """

    length: float = 200.0
    width: float = 10.0
    depth: float = 1.0
    young: float = 210e3
    friction: float = 0.3
    pressure: float = 0.5
    size: float = 5.0
    columns: int = 40

    @property
    def drag_limit(self) -> float:
        """Force that friction can hold in all, N."""
        return self.friction * self.pressure * self.length * self.width

    def dragged(self, forces) -> np.ndarray:
        """Displacement (mm) of the pulled end along a history of forces (N), each reversal from the largest so far.

        Slip starts at the end and reaches as far as friction needs to take up the force, ``a = Q / (μ p b)``; the end
        has then moved by ``Q a / (2 E A)``. On the way back the friction turns round from the end: twice the curve at
        half the change (Masing), as Cattaneo and Mindlin found for spheres.
        """
        EA = self.young * self.width * self.depth

        def virgin(force):
            return np.sign(force) * force**2 / (2 * EA * self.friction * self.pressure * self.width)

        found, peak, at_peak = [], None, None
        for k, force in enumerate(forces):
            if peak is None and k and force < forces[k - 1]:
                peak, at_peak = forces[k - 1], virgin(forces[k - 1])
            found.append(virgin(force) if peak is None else at_peak - 2 * virgin((peak - force) / 2))
        return np.array(found)


def _scene(
    sheet: Sheet,
    folder,
    turn,
    gap,
    clamps,
    zone,
    measurements=(),
    supports="base",
    stop_y=None,
    **tables,
):
    """A sheet whose lower face lies `gap` above a round pad; points and directions are in the sheet's own frame.

    Supports hold it in its normal direction at its corners (or across its whole ends), two at its side, and a stop at
    its far end. `tables` may hold ``deviations`` and ``stages``.
    """
    L, b, h = sheet.length, sheet.width, sheet.depth
    ends = (0, L)
    y, _ = strips.line(0, b, 1 + 2 * max(1, round(b / sheet.size / 2)))
    across = y if supports == "ends" else (0, b)
    locators = [
        dict(name=f"z{i}{j}", point=(at, yj, 0), direction=(0, 0, 1))
        for i, at in enumerate(ends)
        for j, yj in enumerate(across)
    ]
    locators += [
        dict(name=f"y{i}", point=(at, b / 2, 0), direction=(0, 1, 0)) for i, at in enumerate((L / 4, 3 * L / 4))
    ]
    locators.append(dict(name="stop", point=(L, b / 2 if stop_y is None else stop_y, 0), direction=(1, 0, 0)))

    def turned(item, **more):
        return (
            item
            | {key: tuple(turn @ np.array(item[key], dtype=float)) for key in ("point", "direction") if key in item}
            | more
        )

    pad = dict(
        name="base", point=tuple(turn @ [L / 2, b / 2, -h / 2 - gap]), normal=tuple(turn @ [0, 0, 1.0]), radius=2 * L
    )
    sheets = {"sheet": dict(x=0, z=0, length=L, width=b, size=sheet.size, thickness=h, young=sheet.young, poisson=0.0)}
    zone = zone | {
        "name": "base",
        "parts": ("base", "sheet"),
        "friction": sheet.friction,
        "points": [tuple(turn @ p) for p in zone["points"]],
    }
    return strips.build(
        folder,
        sheets,
        turn,
        name="sheet",
        fixtures=[pad],
        locators=[turned(item, part="sheet", radius=0) for item in locators],
        clamps=[turned(item, part="sheet") for item in clamps],
        zones=[zone],
        deviations=tables.get("deviations", []),
        measurements=[turned(item, part="sheet", radius=0, lower=-1, upper=1) for item in measurements],
        stages=[dict(kind="locate"), *tables.get("stages", [dict(kind="clamp", increments=1)]), dict(kind="measure")],
    )


def _centres(sheet):
    x = (np.arange(sheet.columns) + 0.5) / sheet.columns * sheet.length
    return [(xi, sheet.width / 2, 0.0) for xi in x]


def _converged(evaluation):
    if evaluation.failed.any():
        raise ArithmeticError(f"{evaluation.failed.sum()} samples of a sheet on a base did not converge")
    return evaluation


def incline_reaction(sheet: Sheet, context, angle: float) -> tuple[float, float]:
    """Force on the stop below a sheet on an incline, and what it must be, both over the weight.

    The closed form ``max(0, sin α - μ cos α)`` holds whatever the sheet's stiffness: each piece of it slides, or stays,
    by itself. The incline is turned about the vertical as well, so that no axis of it is one of the scene.

    Parameters
    ----------
    angle : float
        α, radians.
    """
    around = 0.7
    c, s = np.cos(around), np.sin(around)
    yaw = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    # The sheet's x runs downhill.
    pitch = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    turn = yaw @ pitch
    weight = sheet.pressure * sheet.width * sheet.length
    # The weight acts on the very points that the pairs read, and the stop lies in line with them: each pair answers its
    # own piece of the weight, and the supports at the corners and at the side carry nothing.
    zone = {"points": _centres(sheet), "mid_surface": True, "patch": 0.0}
    bare = _scene(sheet, context.cache / "meshes", turn, 0.0, [], zone)
    points = assemble(bare, context.cache).contacts.point @ turn
    zone["points"] = [tuple(point) for point in points]
    down = tuple(turn.T @ [0, 0, -1.0])
    clamps = [
        dict(name=f"weight{i}", point=tuple(point), direction=down, force=weight / len(points), radius=0)
        for i, point in enumerate(points)
    ]
    scene = _scene(sheet, context.cache / "meshes", turn, 0.0, clamps, zone, stop_y=points[:, 1].mean())
    evaluation = _converged(context.model(scene).evaluate(np.zeros(0)))
    stop = [locator.name for locator in scene.locators].index("stop")
    return -evaluation.resolutions["clamp"].reaction[0, stop] / weight, max(
        0.0, np.sin(angle) - sheet.friction * np.cos(angle)
    )


def dragged_ends(sheet: Sheet, context, forces) -> np.ndarray:
    """Displacement (mm) of a pressed sheet's end after each of the forces (N) that pull there, away from the sheet."""
    y, share = strips.line(0, sheet.width, 1 + 2 * max(1, round(sheet.width / sheet.size / 2)))
    cell = sheet.length / sheet.columns
    clamps = [
        dict(
            name=f"press{i}",
            point=point,
            direction=(0, 0, -1),
            force=sheet.pressure * cell * sheet.width,
            radius=sheet.width / 2,
            stage="press",
        )
        for i, point in enumerate(_centres(sheet))
    ]
    deviations = []
    for k, step in enumerate(np.diff(forces, prepend=0.0)):
        for j, yj in enumerate(y):
            clamps.append(
                dict(
                    name=f"pull{j}-{k}",
                    point=(0, yj, 0),
                    direction=(-1, 0, 0),
                    force=step * share[j],
                    radius=0,
                    stage=f"pull{k}",
                )
            )
            deviations.append(dict(name=f"pull{j}-{k}", kind="clamp", target=f"pull{j}-{k}", sigma=0))
    measurements = [dict(name=f"end{j}", point=(0, yj, 0), direction=(-1, 0, 0)) for j, yj in enumerate(y)]
    stages = [
        dict(kind="clamp", name=name, increments=1) for name in ("press", *(f"pull{k}" for k in range(len(forces))))
    ]
    scene = _scene(
        sheet,
        context.cache / "meshes",
        np.eye(3),
        0.0,
        clamps,
        {"points": _centres(sheet), "mid_surface": True},
        measurements,
        deviations=deviations,
        stages=stages,
    )
    model = context.model(scene)
    step = np.array([int(name.rpartition("-")[2]) for name in model.parameters])
    force = {clamp.name: clamp.force for clamp in scene.clamps}
    taken_away = -np.array([force[name] for name in model.parameters])
    evaluation = _converged(model.evaluate(np.array([np.where(step > j, taken_away, 0.0) for j in range(len(forces))])))
    return evaluation.measurements @ share


def stop_force(sheet: Sheet, context, load: float, gap: float, alter=lambda scene: scene) -> tuple[float, float]:
    """Force (N) on a stop under the middle of a sheet on two supports, and what beam theory says.

    The middle, loaded by `load` (N), would sink by ``F L³ / (48 E I)``; what of the load is not needed to sink by the
    gap (mm) goes into the stop. `alter` may change the scene before it is solved.
    """
    L, b = sheet.length, sheet.width
    y, share = strips.line(0, b, 1 + 2 * max(1, round(b / sheet.size / 2)))
    clamps = [
        dict(name=f"load{j}", point=(L / 2, yj, 0), direction=(0, 0, -1), force=load * share[j], radius=0)
        for j, yj in enumerate(y)
    ]
    zone = {"points": [(L / 2, b / 2, 0)], "max_gap": 2 * gap, "patch": b / 2}
    scene = _scene(sheet, context.cache / "meshes", np.eye(3), gap, clamps, zone, supports="ends")
    evaluation = _converged(context.model(alter(scene)).evaluate(np.zeros(0)))
    bending = sheet.young * b * sheet.depth**3 / 12
    return float(evaluation.resolutions["clamp"].force[0, :, 0].sum()), max(0.0, load - 48 * bending * gap / L**3)
