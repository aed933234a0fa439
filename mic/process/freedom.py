"""What a step leaves free, seen from the scene alone: rigid parts on the points and directions of what holds them.

A locator, or a clamp that holds a position, at x along d reads ``d · (q + φ × (x - c))`` of a part's rigid motion
(q, φ) about c; a weld reads both parts' motions at its point, second minus first, translations first and rotations
where it carries moment. Contacts hold nothing: they may open.
"""

from __future__ import annotations

import numpy as np

from mic.compliance.support import statically_determinate
from mic.errors import FreeMotion, SceneError
from mic.process.actions import Joints

__all__ = ["check_held", "free"]


def check_held(scene, joints: Joints, plan) -> None:
    """Every step of a stage holds all rigid motions of all parts.

    Parameters
    ----------
    scene : mic.scene.Scene
    joints : Joints
    plan : mic.process.plan.StagePlan

    Raises
    ------
    SceneError
        Naming the stage, what opens in it, the part and the remedy.
    """
    centres, scale = _centres(scene)
    bodies = {part.name: 6 * i for i, part in enumerate(scene.parts)}
    size = np.tile([1.0, 1.0, 1.0, scale, scale, scale], len(bodies))
    for step, before in zip(plan.steps, (None, *plan.steps)):
        held = step.bilateral
        if before is not None and held == before.bilateral:
            continue
        reading = np.zeros((len(held), 6 * len(bodies)))
        for line, (kind, row) in zip(reading, held):
            if kind == "weld":
                number = int(np.searchsorted(joints.first, row, side="right")) - 1
                weld, axis = scene.welds[number], row - int(joints.first[number])
                for name, sign in zip(weld.parts, (-1.0, 1.0)):
                    own = slice(bodies[name], bodies[name] + 6)
                    line[own] = sign * _reading(axis, np.subtract(weld.point, centres[name]))
            else:
                item = getattr(scene, f"{kind}s")[row]
                arm = np.subtract(item.point, centres[item.part])
                line[bodies[item.part] : bodies[item.part] + 6] = [*item.direction, *np.cross(arm, item.direction)]
        try:
            statically_determinate(reading, size)
        except FreeMotion as error:
            share = np.linalg.norm(error.motions.reshape(len(bodies), -1), axis=1)
            raise free(scene, plan, step, error, int(np.argmax(share))) from error


def free(scene, plan, step, error: FreeMotion, part: int) -> SceneError:
    """The error of a step that leaves a part free."""
    opened = [getattr(scene, f"{kind}s")[i].name for kind, i in step.released if kind != "weld"]
    once = f" once {', '.join(opened[:4])}{' …' * (len(opened) > 4)} opened" if opened else ""
    return SceneError(
        f"stages ({plan.name}): {error}{once}, mostly of part {scene.parts[part].name!r}; keep more locators in this "
        "stage, or join the part by welds with moment"
    )


def _reading(axis: int, arm: np.ndarray) -> np.ndarray:
    """What a weld's row reads of a body's motion: a translation at the weld, or a rotation."""
    unit = np.eye(3)[axis % 3]
    return np.array([*unit, *np.cross(arm, unit)] if axis < 3 else [0.0, 0.0, 0.0, *unit])


def _centres(scene) -> tuple[dict[str, np.ndarray], float]:
    """A point of reference for each part, and the size of the assembly, mm."""
    points = np.array([locator.point for locator in scene.locators], dtype=float)
    own = np.array([locator.part for locator in scene.locators])
    centres = {part.name: points[own == part.name].mean(axis=0) for part in scene.parts}
    return centres, max(1.0, float(np.ptp(points, axis=0).max()) / 2)
