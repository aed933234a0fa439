"""Published benchmarks of frictional contact, each as a function of the mesh.

Geometry, loads and published values come from the command files and manuals of code_aster, which name their sources.
The page of the study explains each value and its accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from verification.plane import PATH, Body, Pairs, followed, graded, rectangle

__all__ = ["Punch", "Roller", "cattaneo", "plate", "shoe"]


# --- SSNV503: a shoe on an inclined plane
# ------------------------------------------------------------------------------------------------------


def shoe(stiffer: float = 1.0, divisions: int = 4) -> np.ndarray:
    """A shoe of 40 × 20 mm, pressed onto a plane 2 mm away and pushed along it, held by weak springs.

    Parameters
    ----------
    stiffer : float
        Factor on the modulus of steel; the published solution has a rigid shoe.
    divisions : int
        Elements over the height of the shoe.

    Returns
    -------
    (3, 4) array
        After each load: normal and tangential force on the plane (N), mean normal and tangential displacement of its
        lower corners (mm).
    """
    length, height, pressure = 40.0, 20.0, 300.0
    body = Body(
        *rectangle(np.linspace(0, length, 2 * divisions + 1), np.linspace(0, height, divisions + 1)),
        210e3 * stiffer,
        0.0,
    )
    bottom, top, left, right = (body.side(*of) for of in ((1, 0.0), (1, height), (0, 0.0), (0, length)))
    body.springs(right[[0, -1]], 0, 2.0)
    body.springs(top[[0, -1]], 1, 0.005)
    loads = [
        body.pressed(top, (0, -pressure)),
        *(body.pressed(left, (0.3 * pressure * 2 * f, 0)) for f in (0.99, 1.01)),
    ]
    found = body.reduced(body.rows(bottom, normal_first=True), loads=loads)
    pairs = Pairs(found.H, np.tile([2.0, 0.0], len(bottom)), np.zeros((2 * len(bottom), 0)))
    normal, rows = found.U[:, 0], []
    for legs in ([normal], [normal, normal + found.U[:, 1]], [normal, normal + found.U[:, 2]]):
        force, shift = followed(pairs, 0.3, legs)
        corner = (shift - pairs.b).reshape(-1, 2)[[0, -1]].mean(0)
        rows.append([*force.reshape(-1, 2).sum(0), *corner])
    return np.array(rows)


def rigid_shoe() -> np.ndarray:
    """Closed form for a rigid shoe, as :func:`shoe`: springs of 4 N/mm along the plane, 0.01 N/mm normal to it."""
    normal = 300.0 * 40 - 0.01 * 2
    push = np.array([0.0, *(178.2 * 20, 181.8 * 20)])
    slid = np.maximum(0.0, (push - 0.3 * normal) / 4)
    return np.column_stack([np.full(3, normal), -np.minimum(push, 0.3 * normal), np.full(3, -2.0), slid])


# --- SSNV128: a plate on a rigid plane
# ------------------------------------------------------------------------------------------------------

#: Distance from the loaded face, mm, and published displacement along the plane there, mm.
PLATE = {0.0: 28.6e-3, 1.25: 27.2e-3, 5.0: 22.8e-3, 7.5: 19.8e-3, 11.25: 15.0e-3}


def plate(divisions: int, friction: float = 1.0) -> np.ndarray:
    """A plate of 40 × 40 mm, pressed onto a rigid plane by 50 MPa and along it by 150 MPa; its far face is fixed.

    Parameters
    ----------
    divisions : int
        Elements along each side, a multiple of 16.
    friction : float

    Returns
    -------
    (5,) array
        Displacement along the plane at the points of :data:`PLATE`, mm.
    """
    side = np.linspace(0, 40.0, divisions + 1)
    body = Body(*rectangle(side, side), 130e3, 0.2)
    bottom, top, left, right = (body.side(*of) for of in ((1, 0.0), (1, 40.0), (0, 0.0), (0, 40.0)))
    load = body.pressed(top, (0, -50.0)) + body.pressed(left, (150.0, 0))
    touching = bottom[:-1]
    rows = body.rows(touching, normal_first=True)
    found = body.reduced(rows, held=[*(2 * right), 2 * bottom[-1] + 1], loads=[load])
    pairs = Pairs(found.H, np.zeros(2 * len(touching)), np.zeros((2 * len(touching), 0)))
    shift = followed(pairs, friction, [found.U[:, 0]])[1].reshape(-1, 2)[:, 1]
    return np.interp(list(PLATE), body.nodes[touching, 0], shift)


# --- SSNP154 and SSNA122: contact benchmarks 1 and 2 of NAFEMS
# ------------------------------------------------------------------------------------------------------


#: Path tolerance for the effect of friction, a sixtieth of the result; with ten times this tolerance that effect has an
#: error of 1e-3.
FINE = 1e-4
TURNS = 4  # iterations of the normals; more change the effect of friction by less than 1e-4


def _squeezed(lower: Body, upper: Body, below, above, gap, held, top, friction, chord, tolerance=PATH):
    """Two bodies with matching nodes, the second pressed onto the first along y.

    Displacements are small, but normals follow the deformed face of the first body. On an inclined face, tangential
    motion changes the gap, for a rounded edge by a hundredth. Normals are found by iteration; open pairs have the
    normal of the last closed pair.

    Parameters
    ----------
    below, above : (n,) arrays
        Nodes, from the axis outwards.
    gap : (n,) array
        Along y, mm.
    held : two sequences of int
        Fixed freedoms.
    top : (freedoms,) array
        Load on the second body, N.
    friction : float
    chord : float
        Length over which the slope of a face is computed, mm; node by node the iteration would not converge.
    tolerance : float
        As in :func:`verification.plane.followed`.

    Returns
    -------
    force, motion : (n,) arrays
        Normal forces, N, and displacements of the first body along y, mm.
    """
    a = lower.reduced(lower.rows(below), held[0])
    b = upper.reduced(upper.rows(above), held[1], steered=[top / top.sum()])
    apart, x, angle = np.column_stack([0 * gap, gap]).ravel(), lower.nodes[below, 0], np.zeros(len(gap))
    for _ in range(TURNS):
        along, across = np.cos(angle), np.sin(angle)
        turn = sp.block_diag([[[-s, c], [c, s]] for s, c in zip(across, along)]).tocsr()  # normal, then tangent
        pairs = Pairs(turn @ (turn @ (a.H + b.H)).T, turn @ apart, turn @ b.G)
        force, _ = followed(pairs, friction, [np.zeros(len(pairs.b))], [[top.sum()]], tolerance)
        motion = -(a.H @ (turn.T @ force))[1::2]  # opposite forces act on the first body
        last = np.flatnonzero(force[::2] > 0)[-1]
        left, right = np.maximum(x - chord / 2, x[0]), np.minimum(x + chord / 2, x[-1])
        slope = (np.interp(right, x, motion) - np.interp(left, x, motion)) / (right - left)
        angle = np.arctan(np.append(slope[:last], np.full(len(x) - last, slope[last])))
    return force[::2], motion


def _axis(body: Body) -> np.ndarray:
    return 2 * body.side(0, 0.0)


@dataclass(frozen=True)
class Roller:
    """Half a steel cylinder, R = 50 mm, pressed by 17.5 kN/mm onto half an aluminium block of 100 × 200 mm.

    Attributes
    ----------
    size : float
        Twice the distance of the contact nodes, mm.
    """

    size: float
    radius: float = 50.0
    load: float = 17500.0

    @property
    def modulus(self) -> float:
        """E* of the two, MPa."""
        return 1 / (0.91 / 210e3 + 0.91 / 70e3)

    @property
    def hertz(self) -> tuple[float, float]:
        """Half width (mm) and largest pressure (MPa) by Hertz."""
        a = np.sqrt(4 * 2 * self.load * self.radius / (np.pi * self.modulus))
        return a, 2 * 2 * self.load / (np.pi * a)

    def solve(self, friction: float) -> tuple[float, float, float]:
        """Displacement of the block's top under the axis (mm, down negative), half width and largest pressure, the last
        two as for an elliptic pressure of the same width."""
        R, h = self.radius, self.size
        reach = np.arange(0, 9.0 + h / 2, h)
        angle = np.linspace(np.arcsin(reach[-1] / R), np.pi, 24)[1:]
        round_ = np.column_stack([R * np.sin(angle), R - R * np.cos(angle)])
        arc = np.column_stack([reach, R - np.sqrt(R**2 - reach**2)])
        outline = np.vstack([arc, round_])
        cylinder = Body(*_meshed(outline, 8.0, reach), 210e3, 0.3)
        base = np.array([[100.0, 0], [100.0, -200.0], [0, -200.0]])
        outline = np.vstack([np.column_stack([reach, 0 * reach]), base])
        block = Body(*_meshed(outline, 20.0, reach), 70e3, 0.3)
        below = block.along(lambda x, y: (abs(y) < 1e-9) & (x < reach[-1] + 1e-9))
        above = cylinder.along(lambda x, y: (x < reach[-1] + 1e-9) & (y < R / 2) & (abs(_round(x, R) - y) < h**2 / R))
        above = above[np.isin(np.round(cylinder.nodes[above, 0], 6), np.round(block.nodes[below, 0], 6))]
        top = np.zeros(2 * len(cylinder.nodes))
        top[2 * np.argmax(cylinder.nodes[:, 1]) + 1] = -self.load
        held = [*_axis(block), *block.freedoms(block.side(1, -200.0))], _axis(cylinder)
        x = block.nodes[below, 0]
        f, motion = _squeezed(block, cylinder, below, above, _round(x, R), held, top, friction, 0.5)
        a = 2 * np.sqrt((f * x**2).sum() / f.sum())
        return float(motion[0]), a, 2 * 2 * self.load / (np.pi * a)


def _round(x, R):
    return R - np.sqrt(R**2 - x**2)


def _spaced(first: float, last: float, spacing) -> np.ndarray:
    """Points from the first to the last, at distances of about ``spacing(x)``."""
    x = np.linspace(first, last, 100_001)
    count = np.append(0.0, np.cumsum(0.5 * np.diff(x) * (1 / spacing(x)[1:] + 1 / spacing(x)[:-1])))
    return np.interp(np.linspace(0.0, count[-1], max(1, round(count[-1])) + 1), count, x)


def _meshed(outline, largest: float, reach):
    """A mesh with the spacing of the contact nodes there, coarser with the distance from the contact."""
    kept = len(reach) - 1
    middle = 0.5 * (outline[:kept] + outline[1 : kept + 1])
    near = np.diff(reach) + 0.25 * np.linalg.norm(outline[:, None] - middle, axis=2)
    return graded(outline, np.minimum(near.min(1), largest), kept)


@dataclass(frozen=True)
class Punch:
    """A steel punch, R = 50 mm, its edge rounded by 10 mm, pressed by 100 MPa onto an aluminium cylinder of radius 100
    and height 200 mm.

    Attributes
    ----------
    size : float
        Element size in the contact, mm; within `width` of its end proportional to the distance, down to `least`.
    end : float
        Distance of the contact's end from the axis, mm: 40.40 on the finest mesh, where the edge is round from 40.
    width : float
        mm.
    least : float
        Relative size at the end of the contact.
    chord : float
        Length over which the slope of a face is computed, mm: a seventh of the contact on the rounded edge.
    """

    size: float
    end: float = 40.4
    width: float = 7.0
    least: float = 1 / 256
    chord: float = 0.06

    def _spacing(self, x):
        return self.size * np.clip(abs(x - self.end) / self.width, self.least, 1.0)

    def solve(self, friction: float) -> float:
        """Displacement of the middle of the cylinder's face, mm, down negative."""
        flat, fillet = 40.0, 10.0
        reach = np.concatenate([_spaced(0.0, flat, self._spacing), _spaced(flat, 42.0, self._spacing)[1:]])
        curve = np.where(reach > flat, fillet - np.sqrt(np.maximum(fillet**2 - (reach - flat) ** 2, 0)), 0.0)
        rest = np.arcsin((reach[-1] - flat) / fillet)
        angle = np.linspace(rest, np.pi / 2, max(3, round((np.pi / 2 - rest) * fillet / 2)))[1:]
        side = np.column_stack([flat + fillet * np.sin(angle), fillet - fillet * np.cos(angle)])
        up = np.column_stack([np.full(9, 50.0), np.linspace(20.0, 100.0, 9)])
        across = np.column_stack([np.linspace(40.0, 0.0, 5), np.full(5, 100.0)])
        outline = np.vstack([np.column_stack([reach, curve]), side, up, across])
        punch = Body(*_meshed(outline, 10.0, reach), 210e3, 0.3, revolved=True)
        base = np.array([[60.0, 0], [75.0, 0], [100.0, 0], [100.0, -100.0], [100.0, -200.0], [0, -200.0]])
        outline = np.vstack([np.column_stack([reach, 0 * reach]), base])
        cylinder = Body(*_meshed(outline, 20.0, reach), 70e3, 0.3, revolved=True)
        below = cylinder.along(lambda x, y: (abs(y) < 1e-9) & (x < reach[-1] + 1e-9))
        above = punch.along(
            lambda x, y: (y < 5.0) & (x < reach[-1] + 1e-9) & (abs(np.interp(x, reach, curve) - y) < 1e-9)
        )
        top = punch.pressed(punch.side(1, 100.0), (0.0, -100.0))
        held = [*_axis(cylinder), *cylinder.freedoms(cylinder.side(1, -200.0))], _axis(punch)
        x = cylinder.nodes[below, 0]
        gap = np.where(x > flat, fillet - np.sqrt(np.maximum(fillet**2 - (x - flat) ** 2, 0)), 0.0)
        _, motion = _squeezed(cylinder, punch, below, above, gap, held, top, friction, self.chord, FINE)
        return float(motion[0])


# --- Cattaneo and Mindlin: two cylinders, pressed and sheared
# ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sheared:
    """Tractions between two cylinders as nodal forces, with their positions."""

    x: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray

    @property
    def half_width(self) -> float:
        """a of Hertz's ellipse with the same second moment, mm."""
        return 2 * float(np.sqrt((self.normal * self.x**2).sum() / self.normal.sum()))


def cattaneo(
    divisions: int, share: float = 1.0, friction: float = 0.3, radius: float = 8.0
) -> tuple[Sheared, float, float]:
    """Two half cylinders, E = 200, ν = 0.3, pressed by P = 2 R 0.625 times `share`, then sheared by 0.312 μ P.

    Parameters
    ----------
    divisions : int
        Elements over the half width.
    share : float
        Share of the load.

    Returns
    -------
    sheared : Sheared
    a, c : float
        Half widths of contact and stick by Hertz, Cattaneo and Mindlin, mm.
    """
    R, E, nu = radius, 200.0, 0.3
    P = 2 * R * 0.625 * share
    Q = 0.05851 / 0.625 * P
    a = 2 * np.sqrt(R * P / (2 * np.pi * E / (2 * (1 - nu**2))))
    h = a / divisions
    reach = np.arange(-round(1.3 * divisions), round(1.3 * divisions) + 1) * h
    angle = np.linspace(np.arcsin(reach[-1] / R), np.pi / 2, 14)[1:]
    side = np.column_stack([R * np.sin(angle), R - R * np.cos(angle)])
    outline = np.vstack(
        [
            np.column_stack([reach, _round(reach, R)]),
            side,
            np.column_stack([np.linspace(R, -R, 13)[1:-1], np.full(11, R)]),
            (side * [-1, 1])[::-1],
        ]
    )
    body = Body(*_meshed(outline, 1.5, reach), E, nu)
    above = body.along(
        lambda x, y: (abs(x) < reach[-1] + 1e-9) & (abs(np.interp(x, reach, _round(reach, R)) - y) < 1e-9)
    )
    H = body.reduced(body.rows(above, normal_first=True), held=body.freedoms(body.side(1, R))).H
    mirror = np.tile([-1.0, 1.0], len(above))
    x = body.nodes[above, 0]
    pairs = Pairs(
        H + mirror[:, None] * H * mirror,
        np.column_stack([2 * _round(x, R), 0 * x]).ravel(),
        np.tile(np.eye(2), (len(x), 1)),
    )
    force, _ = followed(pairs, friction, np.zeros((2, 2 * len(x))), [[-P, 0.0], [-P, Q]])
    return Sheared(x, force[::2], -force[1::2]), a, a * np.sqrt(1 - Q / (friction * P))
