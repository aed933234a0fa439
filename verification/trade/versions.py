"""Versions of a scene that buy accuracy in different ways, and the finer ones that judge them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mic import examples
from mic.contact.path import Followed
from mic.scene import SETTINGS, Scene, load_scene
from mic.scene.process import MOVING, FollowedPath
from mic.scene.settings import AUTO
from verification.target import as_set

__all__ = [
    "ALL_FINER",
    "FINE",
    "QUICK",
    "QUICK_TURNED",
    "TRUTHS",
    "TURNED",
    "Knobs",
    "Source",
    "Truth",
    "left_open",
    "named",
    "opened",
    "versions_of",
]

FINE = Followed.tolerance / 4
COARSER = 16  # ratio of path tolerances for the error of the truth: a sixteenth reduces the error to about a sixth
#: Factors on the distance between candidates whose results are averaged, since where candidates lie scatters them.
PLACES = tuple(2 ** (i / 8) for i in (-2, -1, 0, 1))
ALL_FINER = "all finer"


@dataclass(frozen=True)
class Knobs:
    """Changed parameters of a scene; None means unchanged.

    Attributes
    ----------
    size : str or float or None
        Element size, a name or mm.
    factor : float or None
        Factor on the distance between candidates.
    pairs : int or None
        Number of stated pairs in each zone, instead of candidates.
    increments : int or None
        For each step of the process, instead of an adaptive path.
    tolerance : float or None
        Tolerance of the adaptive path.
    element, stiffness, law : str or None
        Keys of the scene.
    """

    size: str | float | None = None
    factor: float | None = None
    pairs: int | None = None
    increments: int | None = None
    tolerance: float | None = None
    element: str | None = None
    stiffness: str | None = None
    law: str | None = None

    def turn(self, scene: Scene) -> Scene:
        """The scene with these parameters changed."""
        change = {key: getattr(self, key) for key in ("element", "stiffness") if getattr(self, key) is not None}
        if self.law is not None:
            change["report"] = scene.report.model_copy(update={"laws": [self.law]})
        if self.size is not None:
            change["parts"] = [part.model_copy(update={"size": self.size}) for part in scene.parts]
        if self.factor is not None or self.pairs is not None:
            factor = 1.0 if self.factor is None else self.factor
            zone = {"spacing": None, "spacing_factor": factor, "pairs": self.pairs, "points": None}
            change["zones"] = [one.model_copy(update=zone) for one in scene.zones]
        if self.increments is not None:
            steps = {"path": None, "increments": self.increments}
            change["stages"] = [one.model_copy(update=steps) if one.kind in MOVING else one for one in scene.stages]
        if self.tolerance is not None:
            change["path"] = FollowedPath(tolerance=self.tolerance)
        return scene.model_copy(update=change)

    @property
    def given(self) -> dict:
        """The changed parameters."""
        return {key: value for key, value in vars(self).items() if value is not None}

    @property
    def words(self) -> str:
        """The changed parameters as text; a tolerance as a multiple of the default."""
        shown = {key: round(value, 3) if key == "factor" else value for key, value in self.given.items()}
        if self.tolerance is not None:
            shown["tolerance"] = f"{self.tolerance / Followed.tolerance:g}×"
        plain = ("size", "element", "law")
        return ", ".join(str(value) if key in plain else f"{key} {value}" for key, value in shown.items())


@dataclass(frozen=True)
class Source:
    """A source of the truth's error: versions as fine as the truth, and coarser ones that differ in this alone.

    Attributes
    ----------
    fine, coarse : tuple of Knobs
        The results of several versions are averaged.
    factor : float
        Converts the difference of the two to the error of the truth.
    samples : int
    """

    fine: tuple[Knobs, ...]
    coarse: tuple[Knobs, ...]
    factor: float
    samples: int


@dataclass(frozen=True)
class Truth:
    """A version finer in every parameter than any setting, and pairs of versions that show its own error.

    Attributes
    ----------
    knobs : Knobs
    samples : int
        Half of them for parameters that are changed one at a time.
    own : dict
        Sources of its error by name. Meshes and pairs are compared in one increment a step, which costs a twentieth,
        so that enough samples show their effect; paths on the mesh of the setting standard.
    """

    knobs: Knobs
    samples: int
    own: dict[str, Source]

    def counts(self) -> dict[Knobs, int]:
        """Number of samples of each version that the truth and its error need."""
        found = {self.knobs: self.samples}
        for source in self.own.values():
            for knobs in (*source.fine, *source.coarse):
                found[knobs] = max(source.samples, found.get(knobs, 0))
        return found


def truth(size: float, factor: float, samples: int, own: int, places: tuple[float, ...] = PLACES) -> Truth:
    """Factors for mesh and candidates. Meshes are of second order, candidates between first and second."""
    cheap, tight = Knobs(size=size, factor=factor, increments=1), Knobs(tolerance=FINE)
    placed = tuple(replace(cheap, factor=place * factor) for place in places)
    apart = tuple(replace(cheap, factor=2**0.5 * place * factor) for place in places)
    sources = {
        "element size": Source((cheap,), (replace(cheap, size=2 * size),), 1 / 3, own),
        # 1 / (2^(p/2) - 1), p from 1 to 2: 2.4 to 1
        "pairs": Source(placed, apart, 1.7, own),
        "path": Source((tight,), (Knobs(tolerance=COARSER * FINE),), 1 / 5, samples),
    }
    return Truth(Knobs(size=size, factor=factor, tolerance=FINE), samples, sources)


TRUTHS = {"lap_joint": truth(0.625, 0.5, 100, 1000), "bracket": truth(1.0, 0.5, 80, 800)}
QUICK = {"lap_joint": truth(0.884, 0.5, 16, 60, places=(1.0,))}
#: Changes from the setting standard: one parameter at a time, then several.
TURNED = {
    "mesh": (Knobs(size="coarse"), Knobs(size="medium")),
    "element": (Knobs(element="dkt-opt"), Knobs(element="p2-cr")),
    "pairs": (Knobs(pairs=34), Knobs(pairs=102), Knobs(factor=1.4), Knobs(factor=1.0)),
    "path": (
        Knobs(increments=1),
        Knobs(increments=4),
        Knobs(tolerance=40 * Followed.tolerance),
        Knobs(tolerance=Followed.tolerance),
    ),
    "law": (Knobs(law="associated"), Knobs(law="frictionless")),
    "stiffness": (Knobs(stiffness="first-order"),),
    "several": (
        Knobs(size="medium", factor=1.4, tolerance=10 * Followed.tolerance),
        Knobs(size="medium", factor=1.0, tolerance=40 * Followed.tolerance),
        Knobs(size="coarse", factor=0.7, tolerance=10 * Followed.tolerance),
        Knobs(factor=1.0, tolerance=10 * Followed.tolerance),
        Knobs(factor=0.7),
    ),
}
QUICK_TURNED = {knob: TURNED[knob][:1] for knob in ("mesh", "path")}


def opened(name: str) -> Scene:
    """A shipped scene under Coulomb's law."""
    scene = load_scene(examples.folder(name))
    report = scene.report.model_copy(update={"laws": ["coulomb"], "fields": False, "slip": True})
    return scene.model_copy(update={"report": report})


def left_open(scene: Scene) -> Scene:
    """The scene with the setting auto, which chooses sizes, candidates and path."""
    names = [f"parts.{part.name}" for part in scene.parts] + [f"zones.{zone.name}" for zone in scene.zones]
    return as_set(scene, "standard").model_copy(update={"setting": AUTO, "left_open": [*names, "path"]})


def named(truth: Truth) -> dict[str, Knobs]:
    """The versions that a truth and its error need, by name."""
    return {ALL_FINER if knobs == truth.knobs else knobs.words: knobs for knobs in truth.counts()}


def versions_of(name: str, truth: Truth, turned=TURNED) -> dict[tuple[str, str], Scene]:
    """All versions of a scene by parameter and value: the truth, what shows its error, settings, changes."""
    scene = opened(name)
    standard = as_set(scene, "standard")
    found = {("truth", name): knobs.turn(standard) for name, knobs in named(truth).items()}
    found |= {("setting", setting): as_set(scene, setting) for setting in SETTINGS}
    return found | {(knob, knobs.words): knobs.turn(standard) for knob, some in turned.items() for knobs in some}
