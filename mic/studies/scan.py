"""From scans of the parts of an assembly to deviations of its scene, with their uncertainty.

A part whose shape varies in the scene (deviations of kind `force`, `shape`, `measured`, `field`) is described by these
deviations: their distributions are the prior of the fit (:mod:`mic.geometry.registration`). The scan of any other part
is taken as it is: its shape is that of least bending energy, caused by corrective forces at points spread over the
part, which become deviations of the scene; the prior is ``exp(−fᵀ C f / 2τ²)`` with C their compliance, a smoothing
spline.

Shapes are those of the part on its datum locators, so that the motion of the fit is the alignment to these.

A part that was scanned on supports has sagged by u(a), which is removed: with C the compliance of the supports, and
c the sag of the free part at them,

    y = h(a) + C f + c + G q ≥ 0,        f ≥ 0,        fᵀ y = 0,        Gᵀ f = g,

for heights h of the free shape and forces f of the supports, which act without friction. f depends on the shape if
there are more than three supports, so that shape and sag are found by iteration.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from mic.compliance.fields import displacement_field
from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.errors import FormatError, SceneError
from mic.geometry.measured_points import TEXT, read_clouds, refuse_unit, sheet_normals, spread, unit_remedy
from mic.geometry.readers import READERS
from mic.geometry.registration import Registration, Shapes, coverage, distance, place, register
from mic.model.sources.gravity import EARTH, TONNES
from mic.process.feasible_assembly import assemble_feasible
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from mic.results.schema import SCANS
from mic.scene import Scene
from mic.scene.deviation import ForceDeviation
from mic.scene.scan import Scan
from mic.system.console import micrometres

__all__ = ["ScanReader", "ScannedAssembly", "checksum", "scan_files"]

POINTS = 120  # forces, approximately, of the shape of a part that is taken as it is
SPREAD = 0.5  # points per square of their spacing, approximately
WITHIN = 5.0  # mm from a part to its supports
FARTHEST, FARTHEST_SHARE = 2.5, 0.01  # largest mean distance from the fitted part, mm, and relative to its diameter
SUSPECT = 0.003  # mean distance, relative to the diameter, from which the scan may be of another part
FEWEST_COVERED, USUALLY_COVERED = 0.3, 0.7  # least share of the part with points, and below which others are tried
MORE = 1.3  # ratio of the shares of another part and of the part that tells that it is the other
SMALL = 1e-9  # relative to the largest compliance
LEAST = 0.1  # mm: mean distance of a good fit
BETTER = 0.5  # ratio of mean distances of another part, or of the mirrored scan, that tells which it is
FREE = "scan"  # name of the force at point k of a part: scan-PART-k


@dataclass(frozen=True)
class ScannedAssembly:
    """Deviations of an assembly from the scans of its parts.

    Attributes
    ----------
    values : dict of str to float
        Deviations by name, N, mm or a factor.
    covariance : (p, p) array
        Covariance of all deviations of the scene, given the scans.
    error : float
        Root mean square of the deviation that the scene's deviations do not describe, mm, of all scanned parts.
    registrations : DataFrame
        As :data:`mic.results.schema.SCANS` declares it: a row for each scanned part.
    messages : tuple of str
        One for each part.
    """

    values: dict[str, float]
    covariance: np.ndarray
    error: float
    registrations: pd.DataFrame
    messages: tuple[str, ...]


@dataclass(frozen=True)
class _ScannedPart:
    """A part with its possible shapes."""

    part: Part
    scan: Scan
    columns: list[int]  # deviations of the scene
    shapes: Shapes
    sag: _Sag | None


class ScanReader:
    """Turns scans of parts into deviations.

    Parameters
    ----------
    scene : Scene
    cache : Path, optional
        Folder of meshes, influence coefficients and fields.
    report : callable, optional
        Called with one line of text before each long step.

    Attributes
    ----------
    model : ReducedModel
        Model of the scene, with forces on its parts that are taken as they are: predict with it.
    free : list of str
        Names of these parts.

    Raises
    ------
    SceneError
        As :func:`mic.build.reduce`; if a part on supports has no density, or would fall off them.
    MissingProvider
        If finite elements are needed, and none are installed.
    """

    def __init__(self, scene: Scene, cache: Path, report: Callable[[str], None] = lambda line: None):
        assembly = assemble_feasible(scene, cache, report)
        shaped = {item.part for item in assembly.scene.deviations if item.kind in ("force", "shape")}
        self.free = [part.name for part in assembly.parts if part.name not in shaped]
        first = len(assembly.scene.deviations)
        if self.free:
            scene = _with_forces(scene, [part for part in assembly.parts if part.name in self.free])
            assembly = assemble_feasible(scene, cache, report)
        self.assembly = assembly
        self.model = ReducedModel.build(assembly, coefficients(assembly, cache, report)[0])
        self._forces = self.model.parameters[first:]  # of the parts that are taken as they are
        self._parts = {part.name: self._scanned_part(p, part, cache) for p, part in enumerate(assembly.parts)}

    def _scanned_part(self, p: int, part: Part, cache: Path) -> _ScannedPart:
        """A part with the fields of its shapes."""
        model, deviations = self.model, self.model.scene.deviations
        functionals, H, G = model.compliance.functionals[p], model.compliance.H[p], model.compliance.G[p]
        own = [j for j, item in enumerate(deviations) if getattr(item, "part", None) == part.name]
        own = [j for j in own if deviations[j].kind in ("force", "shape")]
        forces = model.shape_forces[functionals, own]
        solved, rigid = displacement_field(part, forces, cache)
        motion = np.linalg.lstsq(G, model.shape[functionals, own] - H @ forces, rcond=None)[0]
        fields = solved + rigid @ motion
        mean, sigma = np.array([[deviations[j].mean, deviations[j].sigma] for j in own]).reshape(-1, 2).T
        if part.name in self.free:
            rows = [self.assembly.labels["force"].index(deviations[j].name) for j in own]
            C = self.assembly.rows["force"][rows] @ model.shape[:, own]
            C = 0.5 * (C + C.T) + SMALL * C.max() * np.eye(len(C))  # a force on a locator bends nothing
            shapes = Shapes(part.surface, fields, np.zeros(fields.shape[:2]), mean, C, False)
        else:
            varies = sigma > 0
            offset = fields[:, :, ~varies] @ mean[~varies]
            shapes = Shapes(
                part.surface, fields[:, :, varies], offset, mean[varies], np.diag(sigma[varies] ** -2.0), True
            )
            own = [j for j, item in zip(own, varies) if item]
        scan = next((one for one in self.assembly.scene.scans if one.part == part.name), Scan(part=part.name))
        density = next(one.density for one in self.assembly.scene.parts if one.name == part.name)
        sag = None if scan.supports is None else _Sag(part, scan, density, shapes, cache)
        return _ScannedPart(part, scan, own, shapes, sag)

    def read(self, files: Mapping[str, Path], serial: str = "") -> ScannedAssembly:
        """The deviations of an assembly.

        Parameters
        ----------
        files : mapping of str to Path
            File of the scan by part: STL, PLY or another mesh file, whose points are used, or a table of points.
        serial : str
            Serial number of the assembly, for the table.

        Raises
        ------
        FormatError
            Naming the file: it cannot be read, or its points are not those of the part.
        """
        values = dict.fromkeys(self._forces, 0.0)
        covariance = np.zeros((len(self.model.parameters),) * 2)
        rows, messages, unexplained = [], [], 0.0
        for name, path in files.items():
            own = self._parts[name]
            found, deviation = self._registered(own, path)
            values |= {self.model.parameters[j]: float(x) for j, x in zip(own.columns, found.amplitudes)}
            covariance[np.ix_(own.columns, own.columns)] = found.covariance
            unexplained += found.unexplained**2
            rows.append(_row(own, found, deviation, path, serial))
            messages.append(_message(own, found, deviation, path))
        table = pd.DataFrame(rows, columns=SCANS.names)
        return ScannedAssembly(values, covariance, float(np.sqrt(unexplained)), table, tuple(messages))

    def _registered(self, own: _ScannedPart, path: Path) -> tuple[Registration, float]:
        """The registration of a file in the part's frame, and the root mean square deviation from nominal there, mm."""
        surface = own.part.surface
        points = _points(path, own)
        skin = 0.5 * own.scan.skin * own.part.thickness
        try:
            found = register(points, own.shapes, skin, own.sag)
        except FormatError as problem:
            raise FormatError(f"{path}: {problem}") from None
        self._refuse_other(path, own, found, points)
        shape = own.shapes.offset + own.shapes.fields @ found.amplitudes
        normals = surface.vertex_normals
        if own.scan.align == "best-fit":
            turned = np.cross((surface.points - surface.centroid)[:, None], np.eye(3)[None], axis=2)
            rigid = np.hstack([normals, np.einsum("vij,vj->vi", -turned, normals)])
            q = -np.linalg.lstsq(rigid, (shape * normals).sum(axis=1), rcond=None)[0]
            shape = shape + q[:3] - turned.transpose(0, 2, 1) @ q[3:]
            found = replace(found, pose=found.pose.moved(q, surface.centroid))
        return found, float(np.sqrt(((shape * normals).sum(axis=1) ** 2).mean()))

    def _refuse_other(self, path: Path, own: _ScannedPart, found: Registration, points: np.ndarray) -> None:
        """Refuse a scan that does not fit its part, or fits another one better."""
        surface, name = own.part.surface, own.part.name
        fits = found.distance < SUSPECT * surface.diameter
        if fits and found.covered >= USUALLY_COVERED:
            return
        few = points[:: max(1, len(points) // 2000)]
        trials = {"its mirror image": (few * np.array([-1.0, 1.0, 1.0]), own.shapes)}
        trials |= {f"part {other!r}": (few, one.shapes) for other, one in self._parts.items() if other != name}
        for what, (cloud, shapes) in trials.items():
            try:
                placed = place(cloud, shapes.surface)(cloud)
            except FormatError:
                continue
            there, covered = distance(placed, shapes.surface), coverage(placed, shapes)
            more = there < 2 * max(found.distance, LEAST) and covered > MORE * coverage(found.pose(few), own.shapes)
            if not fits and there < BETTER * found.distance or fits and more and "mirror" not in what:
                raise FormatError(
                    f"{path}: the points fit {what} better than part {name!r}, of which they cover "
                    f"{100 * found.covered:.0f} % at a mean distance of {found.distance:.2g} mm; give the part's scan"
                )
        if found.distance > min(FARTHEST, FARTHEST_SHARE * surface.diameter) or found.covered < FEWEST_COVERED:
            usual = "correct the part or the unit of the file (scans.unit), or scan more of it"
            raise FormatError(
                f"{path}: the points lie {found.distance:.2g} mm off part {name!r} on average, and cover "
                f"{100 * found.covered:.0f} % of it; {unit_remedy(points, surface, own.scan.unit) or usual}"
            )


class _Sag:
    """Displacement of a part by its weight while it lies on supports."""

    def __init__(self, part: Part, scan: Scan, density: float | None, shapes: Shapes, cache: Path):
        at = f"scans of part {part.name!r}"
        if density is None:
            raise SceneError(f"{at}: supports: the part needs density, kg/m³, such as 7850: add it")
        surface, up = part.surface, -np.array(scan.gravity)
        supports = np.array(scan.supports)
        patches = (*(surface.patch(point, 0.0) for point in supports), surface.whole())
        many, n = len(supports), len(supports) + 1
        functionals = Functionals(patches, np.arange(n), np.tile(up, (n, 1)), np.zeros(n, bool), np.zeros(n), ("",) * n)
        solved, rigid = displacement_field(replace(part, functionals=functionals), np.eye(n), cache)
        weight = TONNES * density * part.thickness * float(surface.areas.sum()) * EARTH
        foot = surface.project(supports)
        far = float(foot.distance.max())
        if far > WITHIN:
            worst = int(foot.distance.argmax())
            raise SceneError(f"{at}: supports[{worst}] lies {far:.3g} mm off the part: correct it")
        corners, share = surface.triangles[foot.triangle], foot.barycentric
        modes = rigid.reshape(-1, 6)
        motion = np.linalg.lstsq(modes, solved.reshape(-1, n), rcond=None)[0]
        self.fields = solved - rigid @ motion  # near the nominal part, where the search for the placement begins
        self.heights, offset, self.compliance = (
            np.einsum("sc,scir,i->sr", share, field[corners], up)
            for field in (shapes.fields, shapes.offset[:, :, None], solved)
        )
        self.offset = offset[:, 0]
        across = np.linalg.svd(up[None])[2][1:]
        self.lever = np.column_stack([np.ones(many), (foot.point - surface.centroid) @ across.T])
        self.weight, self._last = weight, np.full(many, weight / many)
        if not self._held():
            raise SceneError(f"{at}: supports: the part would fall off; give supports around its centre of gravity")

    def _held(self) -> bool:
        """Whether forces upwards on the supports carry the weight."""
        from scipy.optimize import nnls

        return nnls(self.lever.T, np.array([self.weight, 0.0, 0.0]))[1] < 1e-9 * self.weight

    def __call__(self, amplitudes: np.ndarray) -> np.ndarray:
        """(v, 3) sag, mm, of a shape with these amplitudes, up to a rigid motion."""
        many = len(self._last)
        C = 0.5 * (self.compliance[:, :many] + self.compliance[:, :many].T)
        h = self.heights @ amplitudes + self.offset - self.weight * self.compliance[:, many]
        if many == 3:
            f = np.linalg.solve(self.lever.T, np.array([self.weight, 0.0, 0.0]))
        else:
            size = max(float(np.abs(C).max()) * self.weight, 1e-12)
            found = minimize(
                lambda x: (0.5 * x @ C @ x * self.weight + x @ h) / size,
                self._last / self.weight,
                jac=lambda x: (C @ x * self.weight + h) / size,
                bounds=[(0.0, None)] * many,
                constraints={
                    "type": "eq",
                    "fun": lambda x: self.lever.T @ x - np.array([1.0, 0.0, 0.0]),
                    "jac": lambda x: self.lever.T,
                },
                method="SLSQP",
                options={"ftol": 1e-12, "maxiter": 200},
            )
            f = found.x * self.weight
        return self.fields[:, :, :many] @ f - self.weight * self.fields[:, :, many]


def scan_files(folder: Path, scene: Scene) -> tuple[dict[str, dict[str, Path]], list[str]]:
    """Files of scans by serial number and part, and names of other files.

    A file belongs to the part that its folder is called, ``PART/SERIAL.stl``, or that its name begins or ends with,
    ``PART-SERIAL.stl``; in a scene of one part to that.

    Raises
    ------
    SceneError
        If two files are of the same part and serial number.
    """
    names = sorted((part.name for part in scene.parts), key=len, reverse=True)
    found: dict[str, dict[str, Path]] = {}
    others = []
    for path in sorted([*folder.glob("*"), *folder.glob("*/*")]):
        if not path.is_file() or path.name.startswith(".") or path.suffix.lower() not in (*TEXT, *READERS):
            continue
        part, serial = _part_and_serial(path.relative_to(folder), names)
        if part is None:
            others.append(path.name)
            continue
        own = found.setdefault(serial, {})
        if part in own:
            raise SceneError(f"{path}: {own[part].name} is of the same part and serial number; remove one of them")
        own[part] = path
    return found, others


def _part_and_serial(path: Path, names: list[str]) -> tuple[str | None, str]:
    """Part and serial number of a file of scans; None if it names no part."""
    stem = path.stem
    if len(path.parts) > 1:
        part = next((name for name in names if name.lower() == path.parts[0].lower()), None)
        if part is not None:
            return part, stem
        return None, stem
    for name in names:
        text, own = stem.lower(), name.lower()
        if text == own:
            return name, ""
        if text.startswith(own) and text[len(own)] in "-_. ":
            return name, stem[len(own) + 1 :]
        if text.endswith(own) and text[-len(own) - 1] in "-_. ":
            return name, stem[: -len(own) - 1]
    return (names[0], stem) if len(names) == 1 else (None, stem)


def checksum(files: Mapping[str, Path]) -> int:
    """Checksum of the contents of files, for a log."""
    value = 0
    for path in files.values():
        value = zlib.crc32(path.read_bytes(), value)
    return value


def _with_forces(scene: Scene, parts: list[Part]) -> Scene:
    """A scene with corrective forces at points spread over some of its parts."""
    forces = []
    for part in parts:
        surface = part.surface
        points = surface.points[spread(surface, np.sqrt(SPREAD * float(surface.areas.sum()) / POINTS))]
        for k, point in enumerate(points.tolist()):
            name = f"{FREE}-{part.name}-{k}"
            force = ForceDeviation(name=name, kind="force", part=part.name, point=point, radius=0.0, sigma=0.0)
            forces.append(force)
    sampling = scene.monte_carlo.model_copy(update={"table": None, "values": None})
    return scene.model_copy(update={"deviations": [*scene.deviations, *forces], "monte_carlo": sampling})


def _points(path: Path, own: _ScannedPart) -> np.ndarray:
    """(n, 3) points of a scan, mm."""
    surface, unit = own.part.surface, own.scan.unit
    clouds = read_clouds(path, unit, surface, None, path.parent)
    if len(clouds) > 1:
        raise FormatError(f"{path}: it holds {len(clouds)} pieces; give a file for each")
    (cloud,) = clouds.values()
    refuse_unit(path, cloud.points, surface, unit)
    if cloud.deviation is None:
        return cloud.points
    foot, normal = sheet_normals(surface, cloud.points)
    return foot + (cloud.deviation + 0.5 * own.scan.skin * own.part.thickness)[:, None] * normal


def _row(own: _ScannedPart, found: Registration, deviation: float, path: Path, serial: str) -> tuple:
    pose = np.column_stack([found.pose.turn, found.pose.shift])
    return (
        str(path),
        serial,
        own.part.name,
        own.scan.align,
        found.points,
        found.used,
        found.outliers,
        found.covered,
        found.pose.degrees,
        found.moved,
        " ".join(f"{number:.10g}" for number in pose.ravel()),
        deviation,
        found.noise,
        found.unexplained,
    )


def _message(own: _ScannedPart, found: Registration, deviation: float, path: Path) -> str:
    frame = "on its datum locators" if own.scan.align == "datum" else "in its best fit"
    count = len(own.columns)
    basis = "shape as scanned" if not own.shapes.known else f"{count} deviation{'s' * (count != 1)} of the scene"
    return (
        f"{path.name}: {found.points} points of {own.part.name}, turned by {found.pose.degrees:.2g}° and moved by "
        f"{found.moved:.3g} mm; {100 * found.outliers:.2g} % outliers, {100 * found.covered:.0f} % covered, noise "
        f"{micrometres(found.noise, 2)}; off nominal by {deviation:.2g} mm {frame} (RMS); {basis}, unexplained "
        f"{micrometres(found.unexplained, 2)}."
    )
