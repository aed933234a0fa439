"""Inputs of derivatives: the scene's deviations, and other numbers of the scene.

Deviations have their names; other inputs are named by their place in the scene,

    ``locators.NAME``          the position of a locator along its direction, mm,
    ``clamps.NAME``            the position of a clamp with a stroke, mm, or the force of one that pushes, N,
    ``clamps.NAME.limit``      the largest force of a clamp with a stroke, N,
    ``welds.NAME.gun``         the force of the gun, N,
    ``zones.NAME.friction``    the coefficient of friction of a zone, the same change in all stages,
    ``welds.NAME.x``           the position of a weld, a locator or a clamp in its sheet, mm along x, y or z of the
                               scene: available if the scene's report requests it (``positions``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mic.errors import ArgumentError
from mic.model.rows import Row
from mic.model.sources import sources
from mic.process.drive import Drive

__all__ = ["Inputs", "Place", "known_inputs"]


def known_inputs(model) -> dict[str, float]:
    """All inputs of a model, with their standard deviations; 0 for inputs that the scene holds fixed.

    Parameters
    ----------
    model : mic.model.reduction.Reduction
    """
    sigma = {one.name: float(one.sigma) for one in model.scene.deviations}
    return dict.fromkeys(_fixed_inputs(model), 0.0) | sigma


def _fixed_inputs(model) -> dict[str, tuple[str, Any]]:
    """The inputs that are not deviations, with the kind and the number of what each changes."""
    scene, first = model.scene, model.joints.first.tolist()
    found: dict[str, tuple[str, Any]] = {f"locators.{one.name}": ("locator", i) for i, one in enumerate(scene.locators)}
    found |= {f"clamps.{one.name}": ("clamp", i) for i, one in enumerate(scene.clamps)}
    limited = [(i, one.name) for i, one in enumerate(scene.clamps) if one.limit is not None]
    found |= {f"clamps.{name}.limit": ("limit", ("clamp", i)) for i, name in limited}
    guns = [(row, one.name) for row, one in zip(first, scene.welds) if one.gun is not None]
    found |= {f"welds.{name}.gun": ("limit", ("weld", row)) for row, name in guns}
    if model.contacts.frictional:
        found |= {f"zones.{one.name}.friction": ("friction", i) for i, one in enumerate(scene.zones)}
    return found | {name: ("position", name) for name in model.labels.get("position", [])}


@dataclass(frozen=True)
class Place:
    """A row whose position in its sheet is an input.

    Attributes
    ----------
    input : int
        Number of the input.
    row : (str, int)
        Kind and number of the row that moves.
    number : int
        Of the position row, which reads by how much the row's reading grows per mm.
    """

    input: int
    row: Row
    number: int


@dataclass(frozen=True)
class Inputs:
    """The change of an assembly by a unit of each of p inputs.

    Attributes
    ----------
    names : list of str
    target, push : dict of str to (p, r) array, (p, c) array
        Positions of rows, and forces of clamps, that no deviation moves.
    limit : dict of (str, int) to (p,) array
        Force limits, by row.
    friction : (m, p) array
        Coefficients of friction.
    places : tuple of Place
    """

    names: list[str]
    target: dict[str, np.ndarray]
    push: np.ndarray
    limit: dict[Row, np.ndarray]
    friction: np.ndarray
    places: tuple[Place, ...]

    @classmethod
    def of(cls, model, names: Sequence[str]) -> Inputs:
        """The inputs of a model with these names.

        Raises
        ------
        ArgumentError
            If a name is unknown, or none is given.
        """
        fixed, known = _fixed_inputs(model), known_inputs(model)
        if not len(names):
            raise ArgumentError("inputs: the list is empty; name at least one")
        for name in names:
            if name not in known:
                reason = _reason(model, name) if isinstance(name, str) else ""
                raise ArgumentError(
                    f"inputs: {name!r} is not an input of this model{reason}; known inputs: " + ", ".join(known)
                )
        p, labels, contacts = len(names), model.labels, model.contacts
        own = dict(zip((one.name for one in model.scene.deviations), sources(model.scene)))
        target = {kind: np.zeros((p, len(labels[kind]))) for kind in ("locator", "clamp")}
        push, friction = np.zeros((p, len(labels["clamp"]))), np.zeros((len(contacts), p))
        limit: dict[Row, np.ndarray] = {}
        places = []
        for i, name in enumerate(names):
            if name in own:
                if own[name].changes == "friction":
                    friction[:, i] = own[name].change(contacts, 1.0).friction[-1] - contacts.friction[-1]
                continue
            kind, number = fixed[name]
            if kind == "position":
                places += [Place(i, row, position) for row, position in _rows_at(model, name)]
            elif kind == "friction":
                friction[contacts.zone == number, i] = 1.0
            elif kind == "limit":
                limit.setdefault(number, np.zeros(p))[i] = 1.0
            else:
                target[kind][i, number] = 1.0
                if kind == "clamp":
                    push[i, number] = 1.0
        return cls(list(names), target, push, limit, friction, tuple(places))

    def drive(self, process, deviations: np.ndarray) -> Drive:
        """The change of the drive by a unit of each input, for deviations (n, p') sample by sample, inputs in a row."""
        model, n, p = process.model, len(deviations), len(self.names)
        count = len(model.parameters)
        zero, unit = process.drive(np.zeros((1, count))), process.drive(np.eye(count))
        own = [model.parameters.index(name) if name in model.parameters else -1 for name in self.names]

        def difference(one, base):
            moved = np.concatenate([one - base, np.zeros_like(base)])
            return np.tile(moved[own], (n, 1))

        found = unit.combined(difference, zero)
        for kind, moved in self.target.items():
            found.target[kind][:] += np.tile(moved, (n, 1))
        found.push[:] += np.tile(self.push, (n, 1))
        normal = set(model.joints.normals)
        for place in self.places:
            # At the moved row the stress-free shape differs, and so does the gap of a weld.
            drawn, (kind, row) = deviations @ (model.rows["position"][place.number] @ model.shape).ravel(), place.row
            if kind != "weld":
                found.target[kind][place.input :: p, row] -= drawn
            elif row in normal:
                found.weld_gap[place.input :: p, row] += model.position_gap[place.number] + drawn
        return found


def _rows_at(model, name: str) -> list[tuple[Row, int]]:
    """The rows that move with a position, each with its position row."""
    numbers = [i for i, label in enumerate(model.labels["position"]) if label == name]
    table, item = name.rsplit(".", 1)[0].split(".", 1)
    kind = table[:-1]
    if kind == "weld":
        weld = [one.name for one in model.scene.welds].index(item)
        return list(zip(model.joints.rows(weld), numbers))
    return [((kind, model.labels[kind].index(item)), numbers[0])]


def _reason(model, name: str) -> str:
    """The reason why a name is not an input, with the remedy; empty if unclear."""
    table, _, item = name.partition(".")
    known = {one.name: one for one in getattr(model.scene, table)} if table in ("locators", "clamps", "welds") else {}
    owner, _, key = item.rpartition(".")
    if owner not in known:
        return ""
    if key in ("x", "y", "z"):
        requested = any(label.startswith(f"{table}.{owner}.") for label in model.labels.get("position", []))
        return (
            f" (its sheet does not extend along {key} there)"
            if requested
            else f' (give the scene positions = ["{table}.{owner}"] in [report])'
        )
    return f" (it has no {key})" if key in ("limit", "gun") else ""
