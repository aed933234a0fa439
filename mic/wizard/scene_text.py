"""Write a proposal as a scene file with comments."""

from __future__ import annotations

import json
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mic.wizard.fixture import Support
from mic.wizard.joints import force
from mic.wizard.proposal import Proposal

__all__ = ["scene_text"]

WIDTH = 118
COMMENT_COLUMN = 44
LIMITS = {"lower": -0.5, "upper": 0.5}  # mm, of measurements
SAMPLES = 100
FRICTION = 0.2
NUGGET = 2.5  # mm, radius
#: Comments by table and key.
COMMENTS: dict[str, dict[str, str]] = tomllib.loads(
    Path(__file__).with_name("comments.toml").read_text(encoding="utf-8")
)


class _SceneFile:
    """Lines of a scene file; each key is explained where it first occurs in a kind of table."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.explained: set[tuple[str, str]] = set()

    def comment(self, text: str) -> None:
        """Add a paragraph of comment."""
        self.lines += textwrap.wrap(
            text, WIDTH, initial_indent="# ", subsequent_indent="# ", break_long_words=False, break_on_hyphens=False
        )

    def tables(self, kind: str, entries: Iterable[str | dict[str, Any]]) -> None:
        """Add tables after the paragraph about their kind; text among the entries becomes a paragraph of comment.

        Entries whose keys begin with an underscore are values for the names in braces of the comments; ``_note``
        stands behind the head of the table.
        """
        for i, entry in enumerate(entries):
            if i == 0:
                self.comment(COMMENTS[kind]["_section"])
            if isinstance(entry, str):
                self.comment(entry)
            else:
                self._table(kind, entry)

    def _table(self, kind: str, entry: dict[str, Any]) -> None:
        if kind == "scene":
            self.lines.append("")
        else:
            head = f"[{kind}]" if kind in ("monte_carlo", "report") else f"[[{kind}]]"
            self.lines.append(f"{head}  # {entry['_note']}" if "_note" in entry else head)
        for key, value in entry.items():
            if key.startswith("_"):
                continue
            line = f"{key} = {_toml(value)}"
            if (kind, key) not in self.explained:
                self.explained.add((kind, key))
                comment = COMMENTS[kind][key].strip().format(**entry)
                aligned = f"{line:<{COMMENT_COLUMN - 1}} # {comment}"
                if len(aligned) <= WIDTH + 2 and "\n" not in line:
                    line = aligned
                else:
                    self.comment(comment)
            self.lines += line.split("\n")
        self.lines.append("")


def scene_text(
    proposal: Proposal, name: str, meshes: Mapping[str, str], welds: str | None = None, points: str | None = None
) -> str:
    """The scene file of a proposal.

    Parameters
    ----------
    proposal : Proposal
    name : str
    meshes : mapping of str to str
        Mesh file of each part by name, relative to the folder of the scene.
    welds, points : str, optional
        CSV files in this folder with the welds and the points to measure.
    """
    file = _SceneFile()
    file.tables("scene", [{"name": name, "description": "Proposed from the meshes."}])
    for sentence in proposal.sentences:
        file.comment(f"NOTE: {sentence}.")
    for kind, entries in {
        "parts": _parts(proposal, meshes),
        "locators": _locators(proposal),
        "zones": _zones(proposal),
        "clamps": _clamps(proposal),
        "welds": _welds(proposal) if welds is None else [{"file": welds, "radius": NUGGET}],
        "stages": _stages(proposal, welds is not None),
        "deviations": _deviations(proposal),
        "measurements": _measurements(proposal) if points is None else [{"file": points, **LIMITS}],
        "monte_carlo": [{"samples": SAMPLES, "seed": 1}],
        "report": [{"laws": ["coulomb"], "fields": True}],
    }.items():
        file.tables(kind, entries)
    return "\n".join(file.lines).rstrip() + "\n"


def _parts(proposal: Proposal, meshes: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    for body in proposal.bodies:
        values: dict[str, Any] = {"name": body.name, "mesh": meshes[body.name]}
        if body.sets:
            values["set"] = body.sets[0] if len(body.sets) == 1 else list(body.sets)
        if body.unit != "mm":
            values["unit"] = body.unit
        values |= {key: _number(getattr(body, key)) for key in ("thickness", "young", "poisson")}
        offset = proposal.offsets[body.name]
        if offset:
            values["offset"] = round(offset, 4)
        size = " × ".join(f"{size:.0f}" for size in np.ptp(body.surface.points, axis=0))
        yield values | {
            "_note": f"{len(body.surface.points)} nodes, {size} mm",
            "_thickness": body.thickness_from,
            "_material": body.material_from,
            "_offset": proposal.why.get(body.name, ""),
        }


def _locators(proposal: Proposal) -> Iterator[str | dict[str, Any]]:
    for name, supports in proposal.fixtures.items():
        yield (
            f"{name}: conditioning of its six locators (ratio of the smallest to the largest singular value) is "
            f"{proposal.conditioned[name]:.2f}; 0 means a free motion."
        )
        for label, support in zip(_labels(supports), supports):
            place = "hole" if support.hole else "point"
            values: dict[str, Any] = {"name": f"{name}-{label}", "part": name, place: _point(support.point)}
            values["direction"] = support.direction_text
            if not support.hole:
                values["radius"] = 4
            yield values | {"stage": "clamp" if support.further else "locate"}


def _labels(supports: Sequence[Support]) -> list[str]:
    """A1, A2, A3, B1, B2, C1 for a 3-2-1, else L1 to L6; A4 and so on for further locators."""
    directions = [support.direction_text for support in supports[:6]]
    labels = [f"L{i}" for i in range(1, 7)]
    if directions[:3] == ["normal"] * 3 and "normal" not in directions[3:]:
        across = max(set(directions[3:]), key=directions[3:].count)
        count = {"B": 0, "C": 0}
        labels = ["A1", "A2", "A3"]
        for direction in directions[3:]:
            letter = "B" if direction == across else "C"
            count[letter] += 1
            labels.append(f"{letter}{count[letter]}")
    return labels + [f"A{i}" for i in range(4, 4 + len(supports) - 6)]


def _zones(proposal: Proposal) -> Iterator[dict[str, Any]]:
    for lap, overlap, reach in zip(proposal.laps, proposal.overlap, proposal.reach):
        gap = lap.gap(proposal.offsets)
        values: dict[str, Any] = {"name": "-".join(lap.names), "parts": lap.names, "friction": FRICTION}
        if overlap:
            values["nominal_overlap"] = overlap
        if reach:
            values["max_gap"] = reach
        if proposal.spacing is not None:
            values["spacing"] = _number(proposal.spacing)
        note = f"{lap.area:.0f} mm², drawn gaps {gap.min() + 0.0:.2f} to {gap.max() + 0.0:.2f} mm"
        yield values | {"_note": note, "_drawn": -gap.min()}


def _clamps(proposal: Proposal) -> Iterator[dict[str, Any]]:
    for number, tong in enumerate(proposal.tongs, 1):
        names, strength = [tong.first.name, tong.second.name], _number(force(tong.first, tong.second))
        yield {"name": f"T{number}", "parts": names, "point": _point(tong.point), "force": strength}


def _welds(proposal: Proposal) -> Iterator[dict[str, Any]]:
    joined = [(lap.names, joints.welds) for lap, joints in zip(proposal.laps, proposal.joints)]
    joined += [(one.names, one.welds) for one in proposal.standing]
    for number, (names, points) in enumerate([one for one in joined if len(one[1])], 1):
        places = [_point(point) for point in points]
        yield {"name": f"W{number}", "parts": names, "points": places, "radius": NUGGET}


def _stages(proposal: Proposal, listed: bool) -> Iterator[dict[str, Any]]:
    yield {"kind": "locate"}
    clamped = bool(proposal.tongs) or any(
        support.further for supports in proposal.fixtures.values() for support in supports
    )
    welded = listed or proposal.welds > 0
    if clamped:
        yield {"kind": "clamp", "_note": "further locators close, then one clamp after the other"}
    if welded:
        yield {"kind": "weld", "_note": "all welds at once; one by one with `sequence = true`"}
    if clamped or welded:
        keep = [f"{name}-{label}" for name in proposal.base for label in _labels(proposal.fixtures[name])[:6]]
        yield {"kind": "release", "keep": keep, "_note": "springback"}
    yield {"kind": "measure", "_note": "reads the measurements"}


def _deviations(proposal: Proposal) -> Iterator[dict[str, Any]]:
    for name, variation in proposal.variation.items():
        if variation.sigma:
            sizes = {"sigma": variation.sigma, "length": _number(variation.length)}
            note = f"1 σ moves no node of the free part by more than {variation.moved:.2g} mm"
            yield {"name": f"{name}-shape", "kind": "field", "part": name, **sizes, "_note": note}
        for label, sigma in zip(_labels(proposal.fixtures[name]), variation.locators):
            target = f"{name}-{label}"
            yield {"name": f"{target}-off", "kind": "locator", "target": target, "sigma": sigma}


def _measurements(proposal: Proposal) -> Iterator[dict[str, Any]]:
    for part, measured in proposal.measured.items():
        for number, point in enumerate(measured, 1):
            place = {"part": part, "point": _point(point), "direction": "normal"}
            yield {"name": f"{part}-M{number}", **place, **LIMITS}


def _point(point: np.ndarray) -> list[float]:
    return [round(float(value), 2) + 0.0 for value in point]


def _number(value: float) -> float | int:
    value = float(f"{value:.6g}")
    return int(value) if value == int(value) else value


def _toml(value: Any) -> str:
    """A value in TOML, with long lists on several lines."""
    text = json.dumps(value, ensure_ascii=False)
    if isinstance(value, list) and len(text) > 90:
        return "[\n" + "".join(f"    {json.dumps(item, ensure_ascii=False)},\n" for item in value) + "]"
    return text
