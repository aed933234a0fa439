"""Two beams stacked and loaded from above, after Springfield and Joshi: the load itself presses them onto each other.

Both beams, each of depth h and width b, lie on their own supports at the ends of the span ℓ, and a uniform load w
presses the upper one. Alike, they share it: w/2 per length passes between them, so that friction bears up to μ w/2 per
length, against ``3 w (ℓ/2 - x)/(4 h)`` that would have to pass to make one beam of them. Beams with ``ℓ > 8/3 μ h``
slide along their whole length from the start; the friction forces bend each beam back by ``μ w x h/4``:

    ``δ = (5 w ℓ⁴/384 ∓ μ w h ℓ³/48) / (2 E I)``,  ``I = b h³/12``.

The minus is that of growing load. When the load falls the beams stick, the slip turns round from the ends, and once it
has done so everywhere (after ``Δw/w = 2 μ/(3 ℓ/(8 h) + μ)`` and a little more) the plus holds, down to nothing [1]_.

.. [1] C. W. Springfield, A. D. Joshi: Interfacial friction effects on the mechanics of stacked beams, Comput. Struct.
       33 (1989) 441-451.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verification import strips

__all__ = ["Stack", "deflections"]


@dataclass(frozen=True)
class Stack:
    """Sizes and load.

    Attributes
    ----------
    span, depth, width : float
        ℓ, h, b, mm.
    young : float
        MPa; Poisson's ratio is 0, so that a strip is a beam.
    friction : float
    load : float
        Largest w, N/mm.
    size : float
        Element size, mm.
    columns : int
        Contact pairs along the span.
    """

    span: float = 100.0
    depth: float = 4.0
    width: float = 10.0
    young: float = 210e3
    friction: float = 0.8
    load: float = 4.0
    size: float = 2.5
    columns: int = 40

    @property
    def bending(self) -> float:
        """2 E I, N mm²."""
        return 2 * self.young * self.width * self.depth**3 / 12

    def free(self, w) -> np.ndarray:
        """Deflection of the middle without friction, mm."""
        return 5 * np.asarray(w) * self.span**4 / 384 / self.bending

    def held(self, w) -> np.ndarray:
        """Reduction of the deflection by friction while the load grows, mm; while the load falls, it is added."""
        return self.friction * np.asarray(w) * self.depth * self.span**3 / 48 / self.bending

    @property
    def turned(self) -> float:
        """Share of the load that must be taken away before slip has turned round along a beam that stuck."""
        return 2 * self.friction / (3 * self.span / (8 * self.depth) + self.friction)


def deflections(stack: Stack, context, shares) -> np.ndarray:
    """(k,) deflections of the middle after each of the loads, shares of the largest, mm."""
    ell, b, h = stack.span, stack.width, stack.depth
    y, _ = strips.line(0, b, 1 + 2 * max(1, round(b / stack.size / 2)))
    cell = ell / stack.columns
    x = (np.arange(stack.columns) + 0.5) * cell
    sheets, locators, measurements = {}, [], []
    for part, z in (("lower", 0.0), ("upper", h)):
        sheets[part] = dict(
            x=0.0, z=z, length=ell, width=b, size=stack.size, thickness=h, young=stack.young, poisson=0.0
        )
        for i, at in enumerate((0.0, ell)):
            locators += [
                dict(name=f"{part}-z{i}{j}", part=part, point=(at, yj, z), direction=(0, 0, 1), radius=0)
                for j, yj in enumerate(y)
            ]
            locators.append(
                dict(
                    name=f"{part}-y{i}",
                    part=part,
                    point=((1 + 2 * i) * ell / 4, b / 2, z),
                    direction=(0, 1, 0),
                    radius=0,
                )
            )
        locators.append(dict(name=f"{part}-x", part=part, point=(ell / 2, b / 2, z), direction=(1, 0, 0), radius=0))
        measurements += [
            dict(
                name=f"{part}-{j}", part=part, point=(ell / 2, yj, z), direction=(0, 0, -1), radius=0, lower=-9, upper=9
            )
            for j, yj in enumerate(y)
        ]
    clamps, deviations = [], []
    for k, step in enumerate(np.diff(shares, prepend=0.0)):
        for i, xi in enumerate(x):
            name = f"load{k}-{i}"
            clamps.append(
                dict(
                    name=name,
                    part="upper",
                    point=(xi, b / 2, h),
                    direction=(0, 0, -1),
                    force=step * stack.load * cell,
                    radius=cell / 2,
                    stage=f"load{k}",
                )
            )
            deviations.append(dict(name=name, kind="clamp", target=name, sigma=0))
    built = strips.build(
        context.cache / "meshes",
        sheets,
        name="stack",
        locators=locators,
        clamps=clamps,
        zones=[
            dict(
                name="interface",
                parts=("lower", "upper"),
                friction=stack.friction,
                points=[(xi, b / 2, 0.0) for xi in x],
            )
        ],
        stages=[
            dict(kind="locate"),
            *(dict(kind="clamp", name=f"load{k}") for k in range(len(shares))),
            dict(kind="measure"),
        ],
        deviations=deviations,
        measurements=measurements,
    )
    model = context.model(built)
    force = {clamp.name: clamp.force for clamp in built.clamps}
    step = np.array([int(name.split("-")[0][4:]) for name in model.parameters])
    taken_away = -np.array([force[name] for name in model.parameters])
    evaluation = model.evaluate(np.array([np.where(step > j, taken_away, 0.0) for j in range(len(shares))]))
    if evaluation.failed.any():
        raise ArithmeticError(f"{evaluation.failed.sum()} load steps of the stacked beams did not converge")
    return evaluation.measurements.mean(axis=1)
