"""Contact problems of known structure, to test, compare and time solvers on.

Two families.  *Compliant* problems have a full-rank compliance like an elastic assembly's, with loads for which most
closed contacts slip, or with a manufactured exact solution.  *Rigid* problems are one step of rigid bodies under
gravity, ``S = H M⁻¹ Hᵀ``: many more contacts than degrees of freedom, so that ``S`` is singular and forces are not
unique.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.contact.laws import Law, find

__all__ = [
    "ContactProblem",
    "RigidScene",
    "arch",
    "box_stack",
    "brick_wall",
    "capsule_pile",
    "clamped_sheet",
    "compliant",
    "hanging_chain",
    "manufactured",
    "rock_heap",
    "slip_dominated",
    "sphere_pile",
]


@dataclass(frozen=True)
class ContactProblem:
    """A compliance, right-hand sides and friction; for manufactured ones also the exact solution.

    Attributes
    ----------
    S : (3m, 3m) array
    b : (n, 3m) array
    mu : (m,) array
    force, displacement : (n, 3m) array or None
        The exact solution, if known.
    """

    S: np.ndarray
    b: np.ndarray
    mu: np.ndarray
    force: np.ndarray | None = None
    displacement: np.ndarray | None = None


def compliant(m: int, rng: np.random.Generator, condition: float = 1e5, tangential: float = 1.0) -> np.ndarray:
    """Compliance of an elastic interface: ``m`` points on a square, coupled over a distance.

    Parameters
    ----------
    m : int
        Contacts.
    condition : float
        Ratio of the largest to the smallest eigenvalue.
    tangential : float
        Tangential compliance over normal compliance.

    Returns
    -------
    (3m, 3m) array
        Symmetric positive definite with mean diagonal one in the normal direction.
    """
    points = rng.random((m, 2))
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    coupling = np.kron(np.exp(-3.0 * distance), np.eye(3))
    mixing = rng.standard_normal((3 * m, 3 * m)) / np.sqrt(3 * m)
    S = coupling + 0.1 * mixing @ mixing.T
    eigenvalues, vectors = np.linalg.eigh(S)
    # Bend the spectrum to the condition asked for, keeping its order and its vectors.
    span = np.log(eigenvalues[-1] / eigenvalues[0]) if m else 1.0
    eigenvalues = eigenvalues[-1] * (eigenvalues / eigenvalues[-1]) ** (np.log(condition) / span)
    S = (vectors * eigenvalues) @ vectors.T
    S /= S.diagonal()[::3].mean()
    units = np.tile([1.0, np.sqrt(tangential), np.sqrt(tangential)], m)
    S *= units[:, None] * units
    return 0.5 * (S + S.T)


def slip_dominated(
    m: int, n: int, rng: np.random.Generator, mu: float = 0.27, condition: float = 1e5
) -> ContactProblem:
    """Compliant contacts with independent random ``b``: about half of them close, nearly all of those slide."""
    return ContactProblem(compliant(m, rng, condition), rng.standard_normal((n, 3 * m)), np.full(m, mu))


def manufactured(
    S: np.ndarray,
    mu: np.ndarray,
    n: int,
    rng: np.random.Generator,
    stick: float = 0.7,
    slide: float = 0.2,
    law: str | Law = "coulomb",
) -> ContactProblem:
    """Choose forces and displacements that obey the law, then ``b = u - S f``.

    Parameters
    ----------
    S : (3m, 3m) array
    mu : (m,) array
    n : int
        Samples.
    stick, slide : float
        Shares of contacts that stick and that slide; the rest are open.
    law : str or Law
        With friction; a contact that slips opens by ``(1 - s) μ‖u_t‖``, ``s`` the law's shift.
    """
    m = len(mu)
    f, u = np.zeros((n, m, 3)), np.zeros((n, m, 3))
    state = rng.random((n, m))
    stuck, sliding = state < stick, (state >= stick) & (state < stick + slide)
    angle = rng.uniform(0.0, 2.0 * np.pi, (n, m))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    normal = rng.uniform(0.2, 1.0, (n, m))
    size = np.sqrt(np.maximum(S.diagonal().reshape(-1, 3).mean(1), np.finfo(float).tiny))
    share = np.where(stuck, rng.uniform(0.0, 0.9, (n, m)), 1.0)
    f[..., 0] = np.where(stuck | sliding, normal / size, 0.0)
    f[..., 1:] = (share * mu * f[..., 0])[..., None] * direction
    slip = rng.uniform(0.1, 1.0, (n, m)) * size
    u[..., 1:] = np.where(stuck, 0.0, -slip)[..., None] * direction
    u[..., 0] = np.where(stuck | sliding, 0.0, rng.uniform(0.1, 1.0, (n, m)) * size)
    u[..., 0] += np.where(stuck, 0.0, (1.0 - find(law).shift) * mu * slip)
    force, displacement = f.reshape(n, -1), u.reshape(n, -1)
    return ContactProblem(S, displacement - force @ S, mu, force, displacement)


@dataclass
class RigidScene:
    """Rigid bodies and the contacts between them; lengths in m, masses in kg, velocities in m/s.

    Body ``-1`` is the ground.  :meth:`problem` gives one step of ``step`` seconds in which contact impulses must
    prevent penetration: ``f`` are impulses, ``u`` relative velocities.
    """

    centre: list
    mass: list
    inertia: list
    contacts: list
    step: float = 1e-2

    @classmethod
    def empty(cls) -> RigidScene:
        return cls([], [], [], [])

    def body(self, centre, mass, inertia) -> int:
        """Add a body; ``inertia`` are its three principal moments about the axes."""
        self.centre.append(np.asarray(centre, dtype=float))
        self.mass.append(mass)
        self.inertia.append(np.asarray(inertia, dtype=float))
        return len(self.mass) - 1

    def box(self, centre, size, density=1000.0) -> int:
        """Add a box with edges along the axes."""
        size = np.asarray(size, dtype=float)
        mass = density * size.prod()
        return self.body(centre, mass, mass / 12.0 * (np.sum(size**2) - size**2))

    def contact(self, a, b, point, normal, gap=0.0):
        """Add a contact at ``point``; ``normal`` points from body ``a`` to body ``b``."""
        normal = np.asarray(normal, dtype=float)
        self.contacts.append((a, b, np.asarray(point, dtype=float), normal / np.linalg.norm(normal), gap))

    def face(self, a, b, corners, normal):
        """Add one contact at each corner of a common face."""
        for corner in corners:
            self.contact(a, b, corner, normal)

    def problem(self, mu, rng, speed=0.0, gravity=(0.0, 0.0, -9.81), samples=1) -> ContactProblem:
        """Compliance and loads of one step from rest, plus random velocities of standard deviation ``speed``."""
        m, bodies = len(self.contacts), len(self.mass)
        H = np.zeros((3 * m, 6 * bodies))
        gap = np.zeros(3 * m)
        for k, (a, b, point, normal, distance) in enumerate(self.contacts):
            helper = np.eye(3)[np.argmin(np.abs(normal))]
            t1 = np.cross(normal, helper)
            t1 /= np.linalg.norm(t1)
            frame = np.stack([normal, t1, np.cross(normal, t1)])
            gap[3 * k] = distance
            for body, sign in ((a, -1.0), (b, 1.0)):
                if body >= 0:
                    H[3 * k : 3 * k + 3, 6 * body : 6 * body + 3] += sign * frame
                    H[3 * k : 3 * k + 3, 6 * body + 3 : 6 * body + 6] += sign * np.cross(
                        point - self.centre[body], frame
                    )
        inverse_mass = np.concatenate(
            [np.r_[np.full(3, 1.0 / mass), 1.0 / inertia] for mass, inertia in zip(self.mass, self.inertia)]
        )
        free = np.zeros((samples, bodies, 6))
        free[..., :3] = self.step * np.asarray(gravity)
        free[..., :3] += speed * rng.standard_normal((samples, bodies, 3))
        b = free.reshape(samples, -1) @ H.T + gap / self.step
        S = (H * inverse_mass) @ H.T
        return ContactProblem(0.5 * (S + S.T), b, np.full(m, float(mu)))


def _corners(low, high, z):
    return [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1])]


def box_stack(boxes: int, size=(1.0, 1.0, 1.0)) -> RigidScene:
    """A tower of boxes, four contacts at each interface."""
    scene = RigidScene.empty()
    below = -1
    for level in range(boxes):
        body = scene.box((0.0, 0.0, (level + 0.5) * size[2]), size)
        scene.face(
            below,
            body,
            _corners((-0.5 * size[0], -0.5 * size[1]), (0.5 * size[0], 0.5 * size[1]), level * size[2]),
            (0.0, 0.0, 1.0),
        )
        below = body
    return scene


def brick_wall(rows: int, columns: int, size=(2.0, 1.0, 0.6)) -> RigidScene:
    """Running bond: every brick on the halves of two below, and against its neighbours at the sides."""
    scene = RigidScene.empty()
    previous: list = []
    for row in range(rows):
        offset = 0.5 * size[0] * (row % 2)
        current: list = []
        for column in range(columns - row % 2):
            x = offset + column * size[0]
            body = scene.box((x, 0.0, (row + 0.5) * size[2]), size)
            span = (x - 0.5 * size[0], x + 0.5 * size[0])
            supports = previous if row else [(-1, span)]
            for other, other_span in supports:
                low, high = max(span[0], other_span[0]), min(span[1], other_span[1])
                if high - low > 1e-9:
                    scene.face(
                        other,
                        body,
                        _corners((low, -0.5 * size[1]), (high, 0.5 * size[1]), row * size[2]),
                        (0.0, 0.0, 1.0),
                    )
            if current:
                side = [(span[0], y, (row + z) * size[2]) for y in (-0.5 * size[1], 0.5 * size[1]) for z in (0.0, 1.0)]
                scene.face(current[-1][0], body, side, (1.0, 0.0, 0.0))
            current.append((body, span))
        previous = current
    return scene


def arch(stones: int, radius: float = 5.0, thickness: float = 1.0, depth: float = 1.0) -> RigidScene:
    """A semicircular arch of voussoirs between two abutments, four contacts at each joint."""
    scene = RigidScene.empty()
    mass = 2000.0 * np.pi * radius * thickness * depth / stones
    before = -1
    for joint in range(stones + 1):
        angle = np.pi * (1.0 - joint / stones)
        body = -1
        if joint < stones:
            middle = angle - 0.5 * np.pi / stones
            body = scene.body((radius * np.cos(middle), 0.0, radius * np.sin(middle)), mass, mass * np.full(3, 0.2))
        normal = (np.sin(angle), 0.0, -np.cos(angle))
        for r in (radius - 0.5 * thickness, radius + 0.5 * thickness):
            for y in (-0.5 * depth, 0.5 * depth):
                scene.contact(before, body, (r * np.cos(angle), y, r * np.sin(angle)), normal)
        before = body
    return scene


def sphere_pile(layers: int, width: int, rng: np.random.Generator) -> RigidScene:
    """Spheres in a loose cubic heap between four walls and a floor, slightly shaken so that contacts differ."""
    scene = RigidScene.empty()
    radius = 0.5
    for level in range(layers):
        for i in range(width):
            for j in range(width):
                jitter = 0.02 * rng.standard_normal(3)
                jitter[2] = abs(jitter[2]) * (level > 0)
                scene.body(np.array([i, j, level + radius]) + jitter, 500.0, np.full(3, 0.4 * 500.0 * radius**2))
    centres = np.array(scene.centre)
    for a in range(len(centres)):
        for b in range(a + 1, len(centres)):
            across = centres[b] - centres[a]
            distance = np.linalg.norm(across)
            if distance < 1.04 * 2 * radius:
                scene.contact(a, b, 0.5 * (centres[a] + centres[b]), across)
        if centres[a][2] < 1.02 * radius:
            scene.contact(-1, a, centres[a] - [0.0, 0.0, radius], (0.0, 0.0, 1.0))
        for axis in range(2):
            for wall, sign in ((0, 1.0), (width - 1, -1.0)):
                if abs(centres[a][axis] - wall) < 0.1:
                    normal = sign * np.eye(3)[axis]
                    scene.contact(-1, a, centres[a] - radius * normal, normal)
    return scene


def rock_heap(rocks: int, rng: np.random.Generator) -> RigidScene:
    """Rocks of two sizes thrown on the ground: faces with normals of their own, one to four contacts at each."""
    scene, radius = RigidScene.empty(), []
    side = int(np.ceil((2.0 * rocks) ** (1 / 3)))
    cells = np.array([(x, y, z) for z in range(side) for x in range(side) for y in range(side)])[:rocks]
    for cell in cells:
        radius.append(rng.choice([0.45, 0.55]))
        centre = cell + [0.5, 0.5, 0.5] + 0.12 * rng.uniform(-1.0, 1.0, 3)
        mass = 2500.0 * 4.2 * radius[-1] ** 3
        scene.body(centre, mass, mass * 0.4 * radius[-1] ** 2 * rng.uniform(0.7, 1.3, 3))
    pairs = [(a, b) for a in range(rocks) for b in range(a + 1, rocks)]
    pairs = [(a, b) for a, b in pairs if np.linalg.norm(cells[a] - cells[b]) <= 1.0 and rng.random() < 0.8]
    for a, b in pairs + [(-1, k) for k in range(rocks) if cells[k][2] == 0]:
        across = scene.centre[b] - scene.centre[a] if a >= 0 else np.array([0.0, 0.0, 1.0])
        middle = scene.centre[b] - 0.5 * across if a >= 0 else scene.centre[b] - [0.0, 0.0, radius[b]]
        normal = across / np.linalg.norm(across) + (0.3 * rng.standard_normal(3) if a >= 0 else 0.0)
        for _ in range(rng.integers(1, 5)):
            scene.contact(a, b, middle + 0.2 * rng.uniform(-1.0, 1.0, 3), normal)
    return scene


def clamped_sheet(m: int, modes: int, rng: np.random.Generator, mu: float = 0.3, samples: int = 1) -> ContactProblem:
    """A sheet that bends in a few modes, clamped between two rigid blocks: ``S`` of rank ``modes`` or less, m contacts.

    Half of the contacts press from above and half from below, each by a deviation of its own.
    """
    side = np.repeat([1.0, -1.0], [m - m // 2, m // 2])
    x, y = rng.random((2, m))
    waves = rng.integers(0, 4, (modes, 2))
    shape = np.array([np.cos(np.pi * a * x) * np.cos(np.pi * b * y) for a, b in waves])
    slope = [0.05 * rng.standard_normal((modes, m)) * shape for _ in range(2)]
    H = np.stack([side * shape, slope[0], slope[1]], axis=-1).reshape(modes, 3 * m)
    stiffness = 1.0 + (waves**2).sum(axis=1) ** 2
    S = (H.T / stiffness) @ H
    load = 3.0 * np.abs(rng.standard_normal((samples, 3 * m))) * np.tile([1.0, 0.0, 0.0], m) / m
    b = 0.2 * load - load @ S + 1e-3 * rng.standard_normal((samples, 3 * m)) @ S
    return ContactProblem(0.5 * (S + S.T), b, np.full(m, mu))


def capsule_pile(levels: int, per_level: int) -> RigidScene:
    """A log pile of capsules, levels crossing at right angles: one contact at each crossing, two on the floor."""
    scene = RigidScene.empty()
    radius, half = 0.1, 0.6
    positions = np.linspace(-half, half, per_level)
    previous: list = []
    for level in range(levels):
        axis = level % 2
        z = radius * (2 * level + 1)
        current: list = []
        for position in positions:
            centre = np.array([0.0, position, z]) if axis == 0 else np.array([position, 0.0, z])
            inertia = np.full(3, 10.0 * (2 * half) ** 2 / 12.0)
            inertia[axis] = 0.5 * 10.0 * radius**2
            body = scene.body(centre, 10.0, inertia)
            if level == 0:
                for end in (-half, half):
                    scene.contact(-1, body, (end, position, 0.0), (0.0, 0.0, 1.0))
            for other, other_position in previous:
                point = (other_position, position, z - radius) if axis == 0 else (position, other_position, z - radius)
                scene.contact(other, body, point, (0.0, 0.0, 1.0))
            current.append((body, position))
        previous = current
    return scene


def hanging_chain(links: int) -> RigidScene:
    """A chain of closed links hanging from the ground, three neighbouring contacts where one link bears on the next."""
    scene = RigidScene.empty()
    above = -1
    for link in range(links):
        z = -0.8 * link
        body = scene.body((0.0, 0.0, z - 0.4), 1.0, (0.08, 0.08, 0.02))
        along = np.eye(3)[link % 2]
        for angle in (-0.6, 0.0, 0.6):
            normal = np.cos(angle) * np.array([0.0, 0.0, -1.0]) + np.sin(angle) * along
            # The link above carries this one: it pushes upwards, so the normal points from this link's inside up.
            scene.contact(above, body, np.array([0.0, 0.0, z]) + 0.1 * np.sin(angle) * along, -normal)
        above = body
    return scene
