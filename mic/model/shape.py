"""The stress-free shape that each source gives its part, as readings of the retained functionals.

The part is held on a statically determinate choice of the locators that it is set down on, or of these and contacts on
which it rests, while the source's force f⁰ acts; the deformed shape is then the part's stress-free shape. A deviation
is measured from there, so it vanishes there:

    y⁰ = H_s f⁰,        with H_s supported on these datum rows.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack

from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.compliance.support import completing, independent, motion_size, statically_determinate
from mic.errors import FreeMotion
from mic.model.sources import sources
from mic.scene.stages import set_down_in

__all__ = ["datum_rows", "shape_readings"]


def datum_rows(assembly, p: int, G: np.ndarray) -> csr_matrix:
    """(6, F_p) rows that part p's shape is measured from: locators, six that hold it, of those it is set down on.

    Of a part that these leave free, rows of its contacts complete them: it is measured from where it rests.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    p : int
    G : (F_p, 6) array
        What the part's functionals read of its rigid motions.

    Raises
    ------
    FreeMotion
        If locators and contacts read less than six motions.
    """
    scene, name, size = assembly.scene, assembly.parts[p].name, motion_size((G,))
    functionals = slice(assembly.offsets[p], assembly.offsets[p + 1])
    first = set_down_in(scene)[name]
    own = [i for i, item in enumerate(scene.locators) if item.part == name and item.stage == first]
    locators = assembly.rows["locator"][own][:, functionals]
    try:
        return locators[statically_determinate(locators @ G, size)]
    except FreeMotion:
        contacts = assembly.rows["contact"][:, functionals]
        locators = locators[independent(locators @ G, size)]
        return vstack([locators, contacts[completing(locators @ G, contacts @ G, size)]], format="csr")


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
            datum = datum_rows(assembly, p, compliance.G[p])
            response = eliminate(
                part, datum, csr_matrix((0, part.size)), load[:, own], identity(part.size, format="csr")
            )
            shape[own, j] = response.L_out[:, 0]
            forces[own, j] = load[:, own].toarray()[0] + datum.T @ response.reaction_L[:, 0]
    return shape, forces
