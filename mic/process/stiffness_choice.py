"""Choice of the stiffness by the deviation of the parts over their thickness.

If sheets of thickness t differ by w from the shape whose stiffness they are given, the error of the key
characteristics stays below about 0.4 w/t of the largest one (`verification/nominal_stiffness`). A tenth, which a gauge
may be off, is reached at a quarter of the thickness. `stiffness = "auto"` uses the nominal stiffness up to there, and
each sample's to first order beyond. That of the mean shape costs less, but leaves contact forces as wrong as the
nominal one does, because they depend on how each sample differs from the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.model.assembly import Assembly
from mic.model.reduction import Reduction
from mic.model.sources import sources
from mic.scene.checks import check_stiffness
from mic.statistics.draw import draw

__all__ = ["LIMIT", "StiffnessChoice", "choose_stiffness", "stiffness_sentences"]

LIMIT = 0.25  # largest deviation in thicknesses from the shape whose stiffness is used
ALLOWED = 0.1  # error of key characteristics there, relative to the largest one
SAMPLES = 200
USED = {
    "nominal": "the nominal one",
    "first-order": (
        "that of each sample's shape, to first order (two sets of influence coefficients for each source and part that "
        "it shapes, and several times the work for each sample)"
    ),
}


@dataclass(frozen=True)
class StiffnessChoice:
    """The stiffness that ``"auto"`` chooses for a scene.

    Attributes
    ----------
    suitable : {"nominal", "first-order"}
        The nominal stiffness, if its shape is at most :data:`LIMIT` away.
    part : str
        Part with the largest deviation over its thickness; empty if there is none.
    deviation : float
        Largest deviation of its shape at its functionals from nominal, root mean square over the samples, over its
        thickness.
    obstacle : str
        Why no other stiffness than the nominal one is available; empty if others are.
    """

    suitable: str
    part: str
    deviation: float
    obstacle: str

    def __str__(self) -> str:
        """Say what is used and why."""
        return f"stiffness: {USED[self.stiffness]}, since {self.measure}{f'; {self.obstacle}' if self.obstacle else ''}"

    @property
    def stiffness(self) -> str:
        """The stiffness in use: the suitable one, or the nominal one if there is an obstacle."""
        return "nominal" if self.obstacle else self.suitable

    @property
    def measure(self) -> str:
        """The deviation in words."""
        if not self.part:
            return "no part deviates in shape"
        return f"part {self.part} deviates by {self.deviation:.2g} times its thickness"


def choose_stiffness(assembly: Assembly, nominal: Reduction) -> StiffnessChoice:
    """Choose the stiffness of an assembly for ``stiffness = "auto"``.

    Parameters
    ----------
    assembly : Assembly
    nominal : Reduction
        Of its nominal meshes.
    """
    scene = assembly.scene
    obstacles = check_stiffness(scene.model_copy(update={"stiffness": "first-order"}))
    deviations = draw(scene, scene.monte_carlo.seed, 0, SAMPLES)
    worst = ("", 0.0)
    for part, rows in zip(assembly.parts, nominal.compliance.functionals):
        if part.superelement is not None:
            continue
        worst = max(worst, (part.name, _size(part, scene, nominal.shape[rows], deviations)), key=lambda one: one[1])
    suitable = "nominal" if worst[1] <= LIMIT else "first-order"
    return StiffnessChoice(suitable, *worst, "" if suitable == "nominal" else next(obstacles, ""))


def _size(part, scene, shape: np.ndarray, deviations: np.ndarray) -> float:
    """Deviation of a part's shape (:class:`StiffnessChoice`); its expansion by temperature is none."""
    grows = [part.name in source.expansion() for source in sources(scene)]
    read = np.where(grows, 0.0, shape) @ deviations.T
    read = read[~part.functionals.rotation]
    if not read.size:
        return 0.0
    return float(np.sqrt(np.mean(np.abs(read).max(axis=0) ** 2))) / part.thickness


def stiffness_sentences(assembly: Assembly, nominal: Reduction) -> list[str]:
    """State the choice of ``"auto"``, or advise a scene whose nominal stiffness is too inaccurate; else empty.

    Parameters
    ----------
    assembly, nominal
        As :func:`choose_stiffness`.
    """
    if assembly.scene.stiffness not in ("nominal", "auto"):
        return []
    choice = choose_stiffness(assembly, nominal)
    if assembly.scene.stiffness == "auto":
        return [str(choice)]
    if choice.suitable == "nominal":
        return []
    remedy = f'`stiffness = "auto"` would use {USED[choice.suitable]}'
    if choice.obstacle:
        remedy += f"; this scene prevents it: {choice.obstacle}"
    return [
        f"{choice.measure}. The nominal stiffness may change key characteristics by up to about "
        f"{100 * ALLOWED / LIMIT * choice.deviation:.0f} % of the largest. {remedy}"
    ]
