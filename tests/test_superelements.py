"""Superelements: reduced stiffness or compliance on named nodes, in every format, beside the shells they came from."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import mmwrite
from scipy.sparse import coo_matrix, csr_matrix
from support.decks import write_deck
from support.panels import functionals
from support.stages import stages_on_the_way
from typer.testing import CliRunner

import mic
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.matrices import read_matrix
from mic.compliance.part import Part
from mic.compliance.superelement import ELEMENT, Superelements, superelement
from mic.errors import FormatError, SceneError
from mic.geometry.script import load_script
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface
from mic.model.assembly import assemble
from mic.options import app

MESHES = Path(__file__).resolve().parents[1] / "meshes"
MM = (1.0, 1.0)
PLACES = [[6.0, 6.0, 0.0], [14.0, 4.0, 0.0], [10.0, 16.0, 0.0]]


@pytest.fixture(scope="module")
def sheet():
    """A flat sheet of 20 × 20 mm."""
    return Surface(*extrude([(0, 0), (20, 0)], 0, 20, 5.0)[:2])


def frame(points, edges, seed=3):
    """K of beams of any stiffness along edges: it resists no rigid motion, and everything else."""
    random = np.random.default_rng(seed)
    K = np.zeros((6 * len(points),) * 2)
    for i, j in edges:
        strain = np.zeros((6, 6 * len(points)))
        strain[:, 6 * j : 6 * j + 6], strain[:, 6 * i : 6 * i + 6] = np.eye(6), -np.eye(6)
        strain[:3, 6 * i + 3 : 6 * i + 6] = -np.cross(np.eye(3), points[j] - points[i]).T  # θ × arm
        root = random.normal(size=(6, 6)) + 4 * np.eye(6)
        K += strain.T @ (root.T @ root * 100) @ strain
    return K


def edges_of(surface):
    sides = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(sides, axis=0)


def tabled(path, points, first=1):
    rows = "".join(f"{first + i},{x!r},{y!r},{z!r}\n" for i, (x, y, z) in enumerate(np.asarray(points).tolist()))
    path.write_text("node,x,y,z\n" + rows)


def market(path, K, points):
    mmwrite(path, coo_matrix(K), precision=17)
    tabled(path.with_suffix(".csv"), points)


def punched(path, K, points):
    """DMIG cards of the lower triangle, as PARAM,EXTOUT,DMIGPCH writes them."""
    lines = ["DMIG    KAAX           0       6       2       0"]
    lines += [f"GRID*   {i + 1:16d}{'':16}{x:16.9f}{y:16.9f}\n*       {z:16.9f}" for i, (x, y, z) in enumerate(points)]
    for column in range(len(K)):
        lines.append(f"DMIG*   {'KAAX':16}{column // 6 + 1:16d}{column % 6 + 1:16d}{'':16}")
        for row in range(column, len(K)):
            if K[row, column]:
                value = f"{K[row, column]:.9E}".replace("E", "D")
                lines.append(f"*       {row // 6 + 1:16d}{row % 6 + 1:16d}{value:>16}{'':16}")
    path.write_text("\n".join(lines) + "\n")


def labelled(path, K, points):
    """Entries as Abaqus writes them for matrix input; the node table stands beside them."""
    rows = ["** matrix input"]
    rows += [
        f"{i // 6 + 1},{i % 6 + 1}, {j // 6 + 1},{j % 6 + 1}, {K[i, j]:.17e}"
        for i in range(len(K))
        for j in range(i + 1)
        if K[i, j]
    ]
    path.write_text("\n".join(rows) + "\n")
    tabled(path.with_suffix(".csv"), points)


def columns(K, layout):
    """Number, first row, and pieces (integers, values) of each column in OUTPUT4, and the column past the last.

    A column is one piece (`layout` "whole"), or its nonzero runs, each described by two integers or one."""
    for number, column in enumerate(K.T, 1):
        if layout == "whole":
            yield number, 1, [((), column)]
            continue
        rows = np.flatnonzero(column)
        runs = [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(run)]
        heads = [(2 * len(run) + 1, run[0] + 1) for run in runs]
        if layout == "one":
            heads = [(first + (length << 16),) for length, first in heads]
        yield number, 0, [(integers, column[run]) for integers, run in zip(heads, runs)]
    yield len(K) + 1, 1, [((), np.ones(1))]


def output4_text(path, K, points, layout="whole"):
    """Nastran's OUTPUT4 as text, three numbers a line."""
    m = len(K)
    lines = [f"{m:8d}{-m if layout == 'two' else m:8d}{6:8d}{2:8d}{'KAAX':8}1P,3E23.16"]
    for number, first, pieces in columns(K, layout):
        size = sum(len(integers) + (2 - first) * len(values) for integers, values in pieces)
        lines.append(f"{number:8d}{first:8d}{size:8d}")
        for integers, values in pieces:
            lines += ["".join(f"{one:{8 if layout == 'two' else 12}d}" for one in integers)] * bool(integers)
            rows = np.split(values, range(3, len(values), 3))
            lines += ["".join(f"{value:23.16E}" for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    tabled(path.with_suffix(".csv"), points)


def output4_binary(path, K, points, layout="whole", order="<"):
    """The same, binary, beside another matrix that is no stiffness."""
    whole = lambda *values: np.array(values, f"{order}i4").tobytes()

    def records(name, K):
        m = len(K)
        yield whole(m, -m if layout == "two" else m, 6, 2) + f"{name:8}".encode()
        for number, first, pieces in columns(K, layout):
            body = b"".join(whole(*integers) + values.astype(f"{order}f8").tobytes() for integers, values in pieces)
            yield whole(number, first, len(body) // 4) + body

    written = [*records("MAAX", np.eye(2)), *records("KAAX", K)]
    path.write_bytes(b"".join(whole(len(record)) + record + whole(len(record)) for record in written))
    tabled(path.with_suffix(".csv"), points)


FORMATS = {
    "a.mtx": market,
    "a.pch": punched,
    "a.txt": labelled,
    "columns.op4": output4_text,
    "strings.op4": lambda *written: output4_text(*written, "two"),
    "packed strings.op4": lambda *written: output4_text(*written, "one"),
    "binary columns.op4": output4_binary,
    "binary strings.op4": lambda *written: output4_binary(*written, "two"),
    "binary packed strings, big-endian.OP4": lambda *written: output4_binary(*written, "one", ">"),
}


def coefficients(path, surface, stiffness=True, unit=MM):
    body = superelement("sheet", read_matrix(path), stiffness, unit, surface, {})
    part = Part("sheet", surface, 1.2, 210e3, 0.3, ELEMENT, functionals(surface, PLACES, 4.0), body)
    return part, Superelements().coefficients([part])["sheet"]


def free(found: InfluenceCoefficients) -> np.ndarray:
    """Displacements by balanced forces without rigid motions; they do not depend on the pins."""
    away = np.linalg.svd(found.G.T, full_matrices=True)[2][6:].T  # balanced sets of forces
    return away.T @ found.H @ away


@pytest.fixture(scope="module")
def K(sheet):
    return frame(sheet.points, edges_of(sheet))


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_matrix_that_was_written(tmp_path, sheet, K, name):
    FORMATS[name](tmp_path / name, K, sheet.points)
    found = read_matrix(tmp_path / name)
    assert found.matrix.toarray() == pytest.approx(K, rel=1e-8, abs=1e-9 * np.abs(K).max())
    assert (6 * (found.node - 1) + found.component == np.arange(len(K))).all()
    assert np.array([found.places[i + 1] for i in range(len(sheet.points))]) == pytest.approx(sheet.points)


def test_rigid_motions_are_read_exactly_between_nodes_and_by_the_arm_of_the_nearest(tmp_path, sheet):
    centre, f = sheet.centroid, functionals(sheet, PLACES, 4.0)
    for chosen in (np.arange(len(sheet.points)), np.arange(0, len(sheet.points), 2)):
        edges = [(i, j) for i in range(len(chosen)) for j in range(i)]
        market(tmp_path / "a.mtx", frame(sheet.points[chosen], edges), sheet.points[chosen])
        part, found = coefficients(tmp_path / "a.mtx", sheet)
        for row in range(len(f)):
            patch, d = f.patches[f.patch[row]], f.direction[row]
            off = f.side[row] * part.thickness / 2 * sheet.normals[patch.triangle]
            place = patch.weight @ (sheet.at(patch.triangle, patch.barycentric) + off) - centre
            rigid = [0, 0, 0, *d] if f.rotation[row] else [*d, *np.cross(place, d)]
            assert found.G[row] == pytest.approx(rigid, abs=1e-12)


def test_compliances_and_other_units_give_the_same_body(tmp_path, sheet, K):
    """The compliance by the pseudoinverse, for balanced forces."""
    market(tmp_path / "mm.mtx", K, sheet.points)
    part, mm = coefficients(tmp_path / "mm.mtx", sheet)
    L = part.superelement.readings(part).toarray()
    away = np.linalg.svd(mm.G.T, full_matrices=True)[2][6:].T
    expected = away.T @ L @ np.linalg.pinv(K, rcond=1e-10) @ L.T @ away
    assert free(mm) == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())
    held = [0, 1, 2, 6 * 4, 6 * 4 + 2, 6 * 20 + 2]  # a 3-2-1 on three nodes
    rest = np.setdiff1d(np.arange(len(K)), held)
    C = np.zeros_like(K)
    C[np.ix_(rest, rest)] = np.linalg.inv(K[np.ix_(rest, rest)])
    market(tmp_path / "c.mtx", C, sheet.points)
    soft = coefficients(tmp_path / "c.mtx", sheet, stiffness=False)[1]
    assert free(soft) == pytest.approx(free(mm), rel=1e-6, abs=1e-9 * np.abs(free(mm)).max())
    scale = np.tile([1e3] * 3 + [1.0] * 3, len(sheet.points))  # displacements in m, moments in N m
    market(tmp_path / "m.mtx", scale[:, None] * K * scale / 1e3, sheet.points / 1e3)
    m = coefficients(tmp_path / "m.mtx", sheet, unit=(1e3, 1e-6))[1]
    assert m.H == pytest.approx(mm.H, rel=1e-9, abs=1e-12 * np.abs(mm.H).max()) and m.G == pytest.approx(mm.G)


def test_nodes_without_a_table_are_those_of_the_mesh_file(tmp_path, sheet, K):
    labelled(tmp_path / "a.txt", K, sheet.points)
    (tmp_path / "a.csv").unlink()
    matrix, numbered = read_matrix(tmp_path / "a.txt"), {i + 1: place for i, place in enumerate(sheet.points)}
    assert superelement("s", matrix, True, MM, sheet, numbered).points == pytest.approx(sheet.points)
    with pytest.raises(SceneError, match=r"part 's': stiffness: the coordinates of node 1 are unknown"):
        superelement("s", matrix, True, MM, sheet, {})


def bent(K):
    """K, negative for its softest motion."""
    value, vector = np.linalg.eigh(K)
    return K - 1.5 * value[6] * np.outer(vector[:, 6], vector[:, 6])


def halves(sheet):
    """K of two bodies."""
    return frame(sheet.points, [(i, j) for i, j in edges_of(sheet) if (i < 10) == (j < 10)])


#: K and its nodes, made from a body and its sheet, and the words of the one error.
NO_BODIES = {
    "held": (
        lambda K, sheet: (K + np.diag([1e4] * 6 + [0] * (len(K) - 6)), sheet.points),
        "resists a rigid (translation|rotation)",
    ),
    "moved": (lambda K, sheet: (K, 1e3 * sheet.points), "resists a rigid rotation"),
    "mixed up": (lambda K, sheet: (K, sheet.points[::-1]), "resists a rigid rotation"),
    "negative": (lambda K, sheet: (-K, sheet.points), "diagonal has negative entries"),
    "two": (lambda K, sheet: (halves(sheet), sheet.points), "leaves more motions free than the six of a rigid body"),
    "giving way": (lambda K, sheet: (bent(K), sheet.points), "it is negative for some motion"),
}


@pytest.mark.parametrize("what", NO_BODIES)
def test_matrices_of_other_than_a_free_elastic_body_are_refused(tmp_path, sheet, K, what):
    change, words = NO_BODIES[what]
    market(tmp_path / "a.mtx", *change(K, sheet))
    with pytest.raises(SceneError, match=rf"part 'sheet': stiffness: .*({words})"):
        coefficients(tmp_path / "a.mtx", sheet)


def test_a_place_without_a_node_and_a_node_without_rotations_are_refused(tmp_path, sheet, K):
    corners = sheet.points[[0, 4, 20, 24]]
    market(tmp_path / "a.mtx", frame(corners, [(0, 1), (1, 3), (2, 3), (0, 2)]), corners)
    with pytest.raises(SceneError, match=r"row 24 is read at \(.*\), where the superelement has no node: .* retain"):
        coefficients(tmp_path / "a.mtx", sheet)
    K = K.copy()
    K[3::6], K[:, 3::6] = 0, 0
    with pytest.raises(SceneError, match=r"resists a rigid rotation|reads degree of freedom 4 of node"):
        market(tmp_path / "b.mtx", K, sheet.points)
        coefficients(tmp_path / "b.mtx", sheet)


MARKET = "%%MatrixMarket matrix coordinate real symmetric\n6 6 1\n1 1 2.0\n"
TABLE = "node,x,y,z\n1,0,0,0\n"
DMIG = "DMIG,KAAX,0,6,1,0\nGRID,1,,0.,0.,0.\nDMIG,KAAX,1,1,,1,1,2.0\n"
OP4 = (
    "       6       6       6       2KAAX    1P,3E23.16\n       1       1       1\n 2.0E+00\n"
    "       7       1       1\n 1.0000000000000000E+00\n"
)
#: Malformed files by name: matrix, table, words.
MALFORMED = {
    "no table.mtx": (MARKET, None, r"needs the table of its nodes, .* beside it: no table\.csv"),
    "too few nodes.mtx": (MARKET.replace("6 6 1", "9 9 1"), TABLE, "has 9 × 9 entries, and the 1 nodes .* have 6"),
    "no square.mtx": (MARKET.replace("symmetric", "general").replace("6 6 1", "6 3 1"), TABLE, "has 6 × 3 entries"),
    "cut.mtx": (MARKET[:-9], TABLE, "cannot be read"),
    "complex.mtx": (MARKET.replace("real", "complex").replace("2.0", "2.0 1.0"), TABLE, "no finite real numbers"),
    "not finite.mtx": (MARKET.replace("2.0", "nan"), TABLE, "no finite real numbers"),
    "zero.mtx": (MARKET.replace("2.0", "0.0"), TABLE, "all its entries are zero"),
    "lopsided.mtx": (MARKET.replace("symmetric", "general").replace("1 1 2.0", "1 2 2.0"), TABLE, "is not symmetric"),
    "a word in the table.mtx": (MARKET, TABLE.replace("0,0,0", "0,zero,0"), "line 2 of its node table .* is not a num"),
    "twice.mtx": (MARKET, TABLE + "1,1,0,0\n", "line 3 of its node table .* gives node 1 again"),
    "no cards.pch": ("$ nothing\n", None, "holds no DMIG cards"),
    "two matrices.pch": (DMIG + "DMIG,KBBX,1,1,,1,1,2.0\n", None, "holds KAAX, KBBX, and one stiffness is wanted"),
    "rectangular.pch": (DMIG.replace("0,6,1", "0,2,1"), None, "KAAX is rectangular"),
    "complex.pch": (DMIG.replace("0,6,1", "0,6,3"), None, "KAAX is complex"),
    "a word.pch": (DMIG.replace("2.0", "two"), None, "line 3: a field of this DMIG is no number"),
    "a freedom.pch": (DMIG.replace("1,1,2.0", "1,7,2.0"), None, "node 1 has a degree of freedom 7"),
    "a system.pch": (DMIG.replace("GRID,1,,", "GRID,1,3,"), None, "line 2: grid points in coordinate system 3"),
    "no table.op4": (OP4, None, r"an OUTPUT4 file needs the table of its nodes, .* beside it: no table\.csv"),
    "no matrix.op4": ("", TABLE, "holds no matrix"),
    "a word.op4": (OP4.replace("2.0", "two"), TABLE, "it is cut short, or no OUTPUT4 file"),
    "a row too many.op4": (OP4.replace("1       1       1\n", "1       7       1\n", 1), TABLE, "it is cut short, or"),
    "complex.op4": (OP4.replace("       2KAAX", "       4KAAX"), TABLE, "KAAX is complex"),
    "binary.sim": ("KAAX", None, "own binary matrices are not read"),
    "a word.txt": ("1,1,1,one,2.0\n", None, "line 1: this is no entry of a matrix"),
    "empty.txt": ("** nothing\n", None, "holds no entries"),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_matrix_ends_in_one_sentence_that_names_it(tmp_path, name):
    matrix, table, words = MALFORMED[name]
    path = tmp_path / name
    path.write_text(matrix)
    if table is not None:
        path.with_suffix(".csv").write_text(table)
    with pytest.raises(FormatError, match=words) as caught:
        read_matrix(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def lap_parts(tmp_path, size):
    """Name, points and triangles of the lap joint's parts, and their decks in a folder."""
    script = load_script(MESHES / "lap_joint" / "geometry.py")
    for name in ("lower", "upper"):
        points, triangles, _ = script.build(name, size)
        write_deck(tmp_path / f"{name}.inp", {"SHEET": (points, triangles)}, first=1)
        yield name, points, triangles


def framed_scene(tmp_path, scale=1.0):
    """The lap joint's scene file beside decks of its parts, and frames that stand for them."""
    text = (MESHES / "lap_joint" / "scene.toml").read_text().replace("fields = true", "fields = false")
    text = text.replace("[[zones]]", "[[zones]]\npairs = 12")
    for seed, (name, points, triangles) in enumerate(lap_parts(tmp_path, 10.0)):
        market(tmp_path / f"{name}.mtx", scale * frame(points, edges_of(Surface(points, triangles)), seed), points)
        drawn = 'geometry = "geometry.py"\nsize = "medium"\n'
        text = text.replace(drawn, f'mesh = "{name}.inp"\nstiffness = "{name}.mtx"\n', 1)
    (tmp_path / "scene.toml").write_text(text)
    return mic.load_scene(tmp_path)


@pytest.mark.slow
def test_a_scene_of_superelements_is_checked_and_computed_without_finite_elements(
    tmp_path, cache, monkeypatch, no_pictures
):
    monkeypatch.setenv("MIC_CACHE", str(cache))
    monkeypatch.setenv("COLUMNS", "200")
    scene = framed_scene(tmp_path)
    output = CliRunner().invoke(app, ["check", str(tmp_path), "--page", str(tmp_path / "check.html")]).output
    assert "of a superelement" in output and "The scene is valid" in output
    samples = np.array([[item.mean + item.sigma for item in scene.deviations]])
    one = mic.reduce(scene, cache).evaluate(samples).measurements
    assert np.isfinite(one).all() and np.abs(one).max() > 1e-6
    before = assemble(scene, cache).inputs
    assert {"lower.mtx", "lower.csv", "lower.inp"} <= set(before)
    framed_scene(tmp_path, 2.0)
    assert assemble(scene, cache).inputs["lower.mtx"] != before["lower.mtx"]
    other = mic.reduce(scene, cache).evaluate(samples).measurements  # and no old coefficients from the cache
    assert np.abs(other - one).max() > 1e-6
    with_fields = scene.model_copy(update={"report": scene.report.model_copy(update={"fields": True})})
    with pytest.raises(SceneError, match="part 'lower': stiffness: .* own nodes only; leave fields and accuracy"):
        assemble(with_fields, cache)


def condensed(K, retained):
    """K condensed to the retained degrees of freedom; the others have no load."""
    rest = np.setdiff1d(np.arange(K.shape[0]), retained)
    dense = K.toarray()
    return dense[np.ix_(retained, retained)] - dense[np.ix_(retained, rest)] @ np.linalg.solve(
        dense[np.ix_(rest, rest)], dense[np.ix_(rest, retained)]
    )


@pytest.mark.fem
def test_the_lap_joint_as_superelements_has_the_key_characteristics_of_its_shells(tmp_path, cache):
    from fem_reference.provider import shell_part

    lap = mic.load_scene(MESHES / "lap_joint")
    changed = {name: {"mesh": f"{name}.inp", "geometry": None, "size": None} for name, *_ in lap_parts(tmp_path, 10.0)}
    scene = lap.model_copy(
        update={
            "parts": [part.model_copy(update=changed[part.name]) for part in lap.parts],
            "zones": [zone.model_copy(update={"pairs": 24}) for zone in lap.zones],
            # A superelement has no mesh that could be divided at fused nuggets.
            "welds": [weld.model_copy(update={"fused": False}) for weld in lap.welds],
            "stages": stages_on_the_way(lap, "one-step"),
            "report": lap.report.model_copy(update={"fields": False}),
            "folder": tmp_path,
        }
    )
    for part in assemble(scene, cache).parts:
        shell = shell_part(part)
        values = shell.vertex_values
        assert values.shape[0] == shell.ndof  # freedoms are those of the vertices
        K = csr_matrix(values @ shell.stiffness_csr() @ values.T)
        read = [part.surface.triangles[patch.triangle].ravel() for patch in part.functionals.patches]
        nodes = np.unique(np.concatenate(read))
        assert len(nodes) < len(part.surface.points)
        retained = (6 * nodes[:, None] + np.arange(6)).ravel()
        market(tmp_path / f"{part.name}.mtx", condensed(K, retained), part.surface.points[nodes])
    parts = [part.model_copy(update={"stiffness": f"{part.name}.mtx"}) for part in scene.parts]
    condensed_scene = scene.model_copy(update={"parts": parts})
    assert [part.element for part in assemble(condensed_scene, cache).parts] == [ELEMENT] * 2
    sigma = np.array([item.sigma for item in lap.deviations])
    samples = np.vstack([0 * sigma, 2 * sigma * np.random.default_rng(2).normal(size=(2, len(sigma)))])
    one, other = (mic.reduce(each, cache).evaluate(samples).measurements for each in (scene, condensed_scene))
    assert np.abs(one).max() > 0.1 and other == pytest.approx(one, rel=0, abs=1e-9 * np.abs(one).max())
