"""The stress-free shape that each source gives its part, as readings of the retained functionals.

The part is held on a statically determinate choice of the locators that it is set down on while the source's force f⁰
acts; the deformed shape is then the part's stress-free shape. A deviation is measured from the locators, so it
vanishes there:

    y⁰ = H_s f⁰,        with H_s supported on the datum locators.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, identity

from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.compliance.support import motion_size, statically_determinate
from mic.model.sources import sources
from mic.scene.stages import set_down_in

__all__ = ["datum_locators", "shape_readings"]


def datum_locators(assembly, part: str, rigid: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(6,) rows of the locators that a part's shape is measured from: six that hold it, of those it is set down on.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    part : str
    rigid : (l, 6) array
        What all locator rows read of the part's rigid motions.
    size : (6,) array
        As :func:`mic.compliance.elimination.statically_determinate` wants it.
    """
    scene = assembly.scene
    first = set_down_in(scene)[part]
    own = np.array([i for i, item in enumerate(scene.locators) if item.part == part and item.stage == first])
    return own[statically_determinate(rigid[own], size)]


def shape_readings(assembly, compliance: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Readings y⁰ (F, p), and the forces f⁰ with their reactions (F, p), of a unit of each of the scene's p deviations.

    Columns of sources that give no shape are zero.
    """
    F, made = compliance.size, sources(assembly.scene)
    shape, forces = np.zeros((F, len(made))), np.zeros((F, len(made)))
    for j, source in enumerate(made):
        load = source.load(assembly.labels, assembly.rows)
        if load is None:
            continue
        for p in np.unique(np.searchsorted(compliance.offsets, load.indices, side="right") - 1):
            own, part = compliance.functionals[p], compliance.part(p)
            locators = assembly.rows["locator"][:, own]
            datum = datum_locators(assembly, assembly.parts[p].name, part.rigid(locators), motion_size(part.G))
            response = eliminate(
                part, locators[datum], csr_matrix((0, part.size)), load[:, own], identity(part.size, format="csr")
            )
            shape[own, j] = response.L_out[:, 0]
            forces[own, j] = load[:, own].toarray()[0] + locators[datum].T @ response.reaction_L[:, 0]
    return shape, forces
