"""Rigid bodies whose one face yields on springs: assemblies small enough to be solved by hand.

Every part is rigid but for its face at `FACE`, which yields along z by 1/k per N and along x and y by half of that.
Items at the face (clamps, welds, contact pairs, measurements) read it; everything else reads the rigid body, also the
moments of welds. All lies in one plane, gaps are along z.
"""

import numpy as np
from scipy.sparse import csr_matrix

import mic
from mic.compliance.blocks import Blocks
from mic.model.assembly import Contacts, GapPoints
from mic.model.rows import KINDS
from mic.process.model import ReducedModel

MU, LIFT, PULL = 0.3, 0.4, 2.0  # of :func:`dragged`
STIFFNESS = 50.0  # N/mm, of a face along z
FACE = (5.0, 5.0, 0.0)
FRAME = np.eye(3)[:, [2, 0, 1]]  # n, t1, t2 of a pair: z, x, y
FAR = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 0], [10, 0, 0], [0, 0, 0]]
ALONG = [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0]]


#: No points between the pairs at which penetration is looked for.
NOWHERE = GapPoints(np.zeros(0, int), np.zeros(0), np.zeros(0, int), np.zeros((0, 3)))


def rows_and_labels(scene, compliance, entries):
    """Rows (r, F) and their labels by kind, from the terms of each row, (part, functional, coefficient) each."""
    names = [part.name for part in scene.parts]
    rows, labels = {}, {}
    for kind, lines in entries.items():
        dense = np.zeros((len(lines), compliance.size))
        for line, terms in zip(dense, lines):
            for part, functional, share in terms:
                line[compliance.offsets[names.index(part)] + functional] += share
        rows[kind], labels[kind] = csr_matrix(dense), [f"{kind}{i}" for i in range(len(lines))]
    for kind in ("locator", "clamp"):
        labels[kind] = [item.name for item in getattr(scene, f"{kind}s")]
    return rows, labels


def stage_list(*steps):
    """Stages of a scene, each given as "kind" or "kind name" or as a table with further keys."""
    return [step if isinstance(step, dict) else dict(zip(("kind", "name"), step.split(maxsplit=1))) for step in steps]


def six(part, stage="locate", far=FAR):
    """Six locators of a part."""
    return [
        {"name": f"{part}{stage[0]}{i}", "part": part, "point": point, "direction": direction, "stage": stage}
        for i, (point, direction) in enumerate(zip(far, ALONG))
    ]


def at_face(part, direction=(0, 0, 1), **keys):
    """An item at the face of a part."""
    return {"part": part, "point": list(FACE), "direction": list(direction)} | keys


def spring_model(gap, weld_gap=(), **scene):
    """Reduced model of a scene whose zones have one pair each, with these gaps, between the faces of their parts."""
    names = [part["name"] for part in scene["parts"]]
    scene = mic.Scene(name="springs", **scene)
    functionals = {name: [(FACE, axis) for axis in ((0, 0, 1), (1, 0, 0), (0, 1, 0))] for name in names}

    def reading(item):
        """Terms of the row that reads an item, (part, functional, coefficient) each."""
        if tuple(item.point) == FACE:
            x, y, z = item.direction
            return [(item.part, j, share) for j, share in enumerate((z, x, y)) if share]
        functionals[item.part].append((item.point, item.direction))
        return [(item.part, len(functionals[item.part]) - 1, 1.0)]

    def joint(parts, axis):
        return [(name, axis, sign) for name, sign in zip(parts, (-1.0, 1.0)) if name in names]

    entries = {kind: [] for kind in KINDS}
    for kind in ("locator", "clamp", "measurement"):
        entries[kind] = [reading(item) for item in getattr(scene, f"{kind}s")]
    entries["contact"] = [joint(zone.parts, axis) for zone in scene.zones for axis in range(3)]
    turns = {name: {} for name in names}
    if any(weld.moment for weld in scene.welds):
        for name, own in functionals.items():
            for axis in range(3):
                turns[name][3 + axis] = len(own)
                own.append((FACE, np.eye(3)[axis]))

    def tied(parts, axis):
        return joint(parts, axis) if axis < 3 else [(n, turns[n][axis], sign) for n, sign in zip(parts, (-1.0, 1.0))]

    size = tuple(6 if weld.moment else 3 for weld in scene.welds)
    entries["weld"] = [tied(weld.parts, axis) for weld, rows in zip(scene.welds, size) for axis in range(rows)]
    blocks = []
    for name, own in functionals.items():
        H = np.zeros((len(own), len(own)))
        H[0, 0], H[1, 1], H[2, 2] = 1 / STIFFNESS, 0.5 / STIFFNESS, 0.5 / STIFFNESS
        G = np.array([[*d, *np.cross(p, d)] for p, d in own], dtype=float)
        for axis, functional in turns[name].items():
            G[functional] = np.eye(6)[axis]
        blocks.append((H, G))
    compliance = Blocks(*zip(*blocks))
    rows, labels = rows_and_labels(scene, compliance, entries)
    no_shape = np.zeros((compliance.size, len(scene.deviations)))
    return ReducedModel(
        scene,
        compliance,
        rows,
        labels,
        contacts_at(
            np.tile(FACE, (len(gap), 1)),
            np.tile(FRAME, (len(gap), 1, 1)),
            np.arange(len(gap)),
            [zone.coefficient("default") for zone in scene.zones],
            gap,
        ),
        NOWHERE,
        size,
        np.concatenate([np.zeros(0), *(np.eye(1, rows)[0] * gap for rows, gap in zip(size, weld_gap))]),
        no_shape,
        no_shape,
        {},
    )


def two_plates(gap, friction=0.2, **change):
    """Model of plates a and b on springs, b's face `gap` above a's, face b measured as M; welds find that gap."""
    keys = {
        "parts": [{"name": name, "mesh": f"{name}.stl", "thickness": 1.0} for name in "ab"],
        "locators": [*six("a"), *six("b")],
        "zones": [{"name": "Z", "parts": ["a", "b"], "friction": friction, "pairs": 1}],
        "measurements": [at_face("b", name="M", lower=-1, upper=1)],
        "stages": stage_list("locate", "clamp", "release", "measure"),
    }
    return spring_model([gap], [gap] * len(change.get("welds", ())), **keys | change)


def contacts_at(points, frames, zone, friction, gap) -> Contacts:
    """Pairs of 1 mm² at points (m, 3), with frames (m, 3, 3) of n, t1 and t2 in columns; friction and gap by pair."""
    m = len(gap)
    return Contacts(
        zone=np.asarray(zone),
        stages=np.array([], dtype=str),
        friction=np.array([friction], dtype=float).reshape(1, m),
        pressure=np.zeros((m, 0, 5)),
        compliance=np.zeros(m),
        gap=np.array(gap, dtype=float),
        overlap=np.zeros(m),
        overlapping=np.zeros(m),
        area=np.ones(m),
        watched=np.zeros(m, bool),
        layer=np.zeros(m),
        nugget=np.full(m, -1),
        bearing=np.ones(m),
        point=np.asarray(points, dtype=float),
        frame=np.asarray(frames, dtype=float),
        dimension=3,
    )


def clamped(names, gap, friction=0.0, **keys):
    """Model of parts that their locators hold to the end; the face of each is a zone with the next one's, `gap` above
    it: zone z with two parts, z1, z2 … with more."""
    pairs = list(zip(names, names[1:]))
    scene = {
        "parts": [{"name": name, "mesh": f"{name}.stl", "thickness": 1.0} for name in names],
        "locators": [locator for name in names for locator in six(name)],
        "zones": [
            {"name": f"z{i}" if len(pairs) > 1 else "z", "parts": list(pair), "friction": friction, "pairs": 1}
            for i, pair in enumerate(pairs, 1)
        ],
        "stages": stage_list("locate", "clamp", "measure"),
    }
    return spring_model([gap] * len(pairs), **scene | keys)


def dragged(**changes):
    """b is lifted by h = P/2 at its face and presses on t, which moves along x by D and drags it by μ h/4: M and N read
    b and t along x."""
    scene = {
        "clamps": [at_face("t", (1, 0, 0), name="T", stroke=0.0)],
        "measurements": [
            at_face("b", (1, 0, 0), name="M", lower=-1, upper=1),
            at_face("t", (1, 0, 0), name="N", lower=PULL - 1, upper=PULL + 1),
        ],
        "deviations": [
            {"name": "P", "kind": "locator", "target": "bl1", "mean": 2 * LIFT, "sigma": 0.1},
            {"name": "D", "kind": "clamp", "target": "T", "mean": PULL, "sigma": 0.05},
        ],
    }
    return clamped("bt", 0.0, **{"friction": MU} | scene | changes)
