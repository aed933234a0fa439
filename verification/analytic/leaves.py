"""Two leaves pressed together and bent: Goodman and Klumpp's layered cantilever, as one half of a beam on two supports.

The leaves, each of depth h, width b and length 2 L, lie on each other, are supported at both ends and loaded by 2 P in
the middle, a half of it on each leaf. By symmetry the middle neither turns nor slips, so each half is a cantilever of
length L with the tip load P. The clamping pressure p is brought on by opposite forces on the two leaves, one couple for
each contact pair.

While the leaves stick they are one beam of depth 2 h; its shear stress at the interface, 3 P / (4 b h), is the same
along the whole span, so that all of it begins to slip at once, at P = 4/3 μ p b h. After that the friction stress μ p
on each leaf's face, half a depth off its axis, works as a distributed couple against the load [1]_.

.. [1] L. E. Goodman, J. H. Klumpp: Analysis of slip damping with reference to turbine-blade vibration, J. Appl. Mech.
       23 (1956) 421-429.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verification import strips

__all__ = ["Leaves", "deflections", "slips"]


@dataclass(frozen=True)
class Leaves:
    """Sizes and loads.

    Attributes
    ----------
    length : float
        L, mm, half of the span.
    depth : float
        h, mm, of each leaf.
    width : float
        b, mm.
    young : float
        MPa; Poisson's ratio is 0, so that a strip is a beam.
    friction : float
    pressure : float
        p, MPa.
    size : float
        Element size, mm.
    columns : int
        Contact pairs along the span, an even number.
    """

    length: float = 100.0
    depth: float = 2.0
    width: float = 10.0
    young: float = 210e3
    friction: float = 0.3
    pressure: float = 0.5
    size: float = 5.0
    columns: int = 40

    @property
    def slip_load(self) -> float:
        """P at which the leaves begin to slip, N: ``4/3 μ p b h``."""
        return 4 / 3 * self.friction * self.pressure * self.width * self.depth

    @property
    def stuck_compliance(self) -> float:
        """Deflection per load of the leaves as one beam, mm/N: ``L³ / (2 E b h³)``."""
        return self.length**3 / (2 * self.young * self.width * self.depth**3)

    @property
    def sliding_compliance(self) -> float:
        """Further deflection per further load of the sliding leaves, mm/N: four times as much."""
        return 2 * self.length**3 / (self.young * self.width * self.depth**3)

    def exact(self, loads) -> np.ndarray:
        """Deflections (mm) along a load history from zero (N), each load one after the other.

        A sliding leaf pair turns round by sticking, and slides back after twice the slip load: the pair is a spring in
        series with a spring beside a slider, that is kinematic hardening (Masing).
        """
        deflection, slid, found = 0.0, 0.0, []
        # δ = k1 P + s with the sliding part s; the slider holds while |P - s / (k2 - k1)| <= P_s.
        extra = self.sliding_compliance - self.stuck_compliance
        for load in loads:
            back = load - slid / extra
            slid = extra * (load - np.sign(back) * self.slip_load) if abs(back) > self.slip_load else slid
            deflection = self.stuck_compliance * load + slid
            found.append(deflection)
        return np.array(found)

    def loop_area(self, peak: float) -> float:
        """Energy that friction takes from the whole beam in one cycle between ±peak (N), N mm.

        Twice that of a half, whose loop in the (δ, P) plane is the parallelogram ``4 P_s (P - P_s) (k2 - k1)``.
        """
        return 2 * 4 * self.slip_load * (peak - self.slip_load) * (self.sliding_compliance - self.stuck_compliance)

    def exact_slips(self, load: float, x) -> np.ndarray:
        """Sliding freely, the upper leaf's face moves along x against the lower's by h times the slope, mm; mean over
        each pair's cell."""
        x, cell = np.asarray(x), 2 * self.length / self.columns
        bending = self.young * self.width * self.depth**3 / 12
        return np.sign(x) * self.depth * load / 2 * (self.length * np.abs(x) - x**2 / 2 - cell**2 / 24) / bending

    def welded_deflection(self, load: float, at: float) -> float:
        """Deflection of frictionless leaves that are tied at the distance `at` (mm) from the middle, mm.

        The tie carries the axial force N of a portal: each leaf is bent back by N h / 2, and turns a quarter as much
        there as it would without the tie, whatever its place.
        """
        L, EI = self.length, self.young * self.width * self.depth**3 / 12
        free = load / 2 * (L * at - at**2 / 2) / EI  # rotation at the tie without it
        couple = 3 * EI * (free / 4) / at
        return load / 2 * L**3 / (3 * EI) - couple * (at * L - at**2 / 2) / EI


def _on_leaves(leaves: Leaves, loads, x, y, share):
    """Locators, clamps, measurements and deviations of both leaves.

    Parameters
    ----------
    leaves, loads
        As :func:`scene` takes them.
    x, y : array
        Places of the pressing clamps along the span, and of the points across the width, mm.
    share : array
        Share of a load at each point across the width.
    """
    L, b, h = leaves.length, leaves.width, leaves.depth
    cell = 2 * L / leaves.columns
    locators, clamps, measurements, deviations = [], [], [], []
    for part, z in (("lower", 0.0), ("upper", h)):
        for i, at in enumerate((-L, L)):
            locators += [
                dict(name=f"{part}-z{i}{j}", part=part, point=(at, yj, z), direction=(0, 0, 1), radius=0)
                for j, yj in enumerate(y)
            ]
            locators.append(
                dict(name=f"{part}-y{i}", part=part, point=(at / 2, b / 2, z), direction=(0, 1, 0), radius=0)
            )
        locators.append(dict(name=f"{part}-x", part=part, point=(0, b / 2, z), direction=(1, 0, 0), radius=0))
        press = leaves.pressure * cell * b * (1 if part == "lower" else -1)
        clamps += [
            dict(
                name=f"{part}-p{i}",
                part=part,
                point=(xi, b / 2, z),
                direction=(0, 0, 1),
                force=press,
                radius=cell / 2,
                stage="press",
            )
            for i, xi in enumerate(x)
        ]
        for j, yj in enumerate(y):
            measurements.append(
                dict(name=f"{part}-{j}", part=part, point=(0, yj, z), direction=(0, 0, -1), radius=0, lower=-1, upper=1)
            )
            for k, step in enumerate(np.diff(loads, prepend=0.0)):
                # The middle carries 2 P, each leaf P.
                clamps.append(
                    dict(
                        name=f"{part}-{j}-load{k}",
                        part=part,
                        point=(0, yj, z),
                        direction=(0, 0, -1),
                        force=step * share[j],
                        radius=0,
                        stage=f"load{k}",
                    )
                )
                deviations.append(dict(name=f"{part}-{j}-load{k}", kind="clamp", target=f"{part}-{j}-load{k}", sigma=0))
    return locators, clamps, measurements, deviations


def scene(
    leaves: Leaves,
    folder,
    loads,
    weld_at: float | None = None,
    increments: int | None = None,
    mid_surface: bool = False,
):
    """The scene of a load history: a clamp stage presses the leaves together, one further clamp stage brings each next
    load.

    A deviation for each load's clamps can take them away again, so that one batch shows the state after every load.

    Parameters
    ----------
    leaves : Leaves
    folder : Path
        Where the meshes go.
    loads : sequence of float
        P after each stage, N.
    weld_at : float, optional
        Welds across the whole width at this distance to both sides of the middle, mm.
    increments : int, optional
        Of each stage that brings a load; followed without.
    mid_surface : bool
        Let the pairs read the mid-surfaces, where friction has no lever.
    """
    L, b, h = leaves.length, leaves.width, leaves.depth
    y, share = strips.line(0, b, 1 + 2 * max(1, round(b / leaves.size / 2)))
    x = (np.arange(leaves.columns) + 0.5) / leaves.columns * 2 * L - L
    sheets = {
        name: dict(x=-L, z=z, length=2 * L, width=b, size=leaves.size, thickness=h, young=leaves.young, poisson=0.0)
        for name, z in (("lower", 0.0), ("upper", h))
    }
    locators, clamps, measurements, deviations = _on_leaves(leaves, loads, x, y, share)
    zone = dict(
        name="interface",
        parts=("lower", "upper"),
        friction=leaves.friction,
        points=[(xi, b / 2, 0.0) for xi in x],
        mid_surface=mid_surface,
    )
    # A row of points across the width: a nugget of any length along the span would shorten the stretched part of the
    # leaves.
    welds = (
        [
            dict(name=f"W{i}{j}", parts=("lower", "upper"), point=(at, yj, 0), radius=0, moment=False)
            for i, at in enumerate((-weld_at, weld_at))
            for j, yj in enumerate(y)
        ]
        if weld_at
        else []
    )
    stages = [
        dict(kind="locate"),
        dict(kind="clamp", name="press"),
        *([dict(kind="weld")] if welds else []),
        *(dict(kind="clamp", name=f"load{k}", increments=increments) for k in range(len(loads))),
        dict(kind="measure"),
    ]
    return strips.build(
        folder,
        sheets,
        name="leaves",
        locators=locators,
        clamps=clamps,
        welds=welds,
        zones=[zone],
        stages=stages,
        deviations=deviations,
        measurements=measurements,
        report={"slip": True},
    )


def slips(leaves: Leaves, context, load: float) -> tuple[np.ndarray, np.ndarray]:
    """Places of the pairs along x, and the slip along x of each under one load, mm."""
    model = context.model(scene(leaves, context.cache / "meshes", [load]))
    displacement = model.evaluate({}).resolutions["load0"].displacement[0]
    tangents = model.contacts.frame[:, 0, 1:]  # x components of t1 and t2
    return model.contacts.point[:, 0], (displacement[:, 1:] * tangents).sum(1)


def deflections(
    leaves: Leaves,
    context,
    loads,
    weld_at: float | None = None,
    increments: int | None = None,
    mid_surface: bool = False,
) -> np.ndarray:
    """(k,) deflections of the middle after each of the loads, mm; the arguments are those of :func:`scene`."""
    built = scene(leaves, context.cache / "meshes", loads, weld_at, increments, mid_surface)
    model = context.model(built)
    force = {clamp.name: clamp.force for clamp in built.clamps}
    step = np.array([int(name.rpartition("load")[2]) for name in model.parameters])
    taken_away = -np.array([force[name] for name in model.parameters])
    # Sample j brings the loads 0 … j; the first sample none.
    evaluation = model.evaluate(np.array([np.where(step > j, taken_away, 0.0) for j in range(-1, len(loads))]))
    if evaluation.failed.any():
        raise ArithmeticError(f"{evaluation.failed.sum()} load steps of the layered cantilever did not converge")
    middle = evaluation.measurements.mean(axis=1)
    return middle[1:] - middle[0]
