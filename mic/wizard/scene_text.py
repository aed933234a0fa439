"""Write a proposal as a scene file with comments."""

from __future__ import annotations

import json
import os
import textwrap
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mic.wizard.bodies import Body
from mic.wizard.fixture import Support
from mic.wizard.joints import force
from mic.wizard.proposal import Proposal

__all__ = ["scene_text"]

WIDTH = 118
COMMENT_COLUMN = 44
LIMIT = 0.5  # mm
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

    def section(self, kind: str) -> None:
        """Add the paragraph about a kind of table."""
        self.comment(COMMENTS[kind]["_section"])

    def table(self, kind: str, values: dict[str, Any], note: str = "", **details: Any) -> None:
        """Add a table; `details` replace the names in braces of its comments."""
        if kind != "scene":
            head = f"[{kind}]" if kind in ("monte_carlo", "report") else f"[[{kind}]]"
            self.lines.append(f"{head}  # {note}" if note else head)
        for key, value in values.items():
            line = f"{key} = {_toml(value)}"
            if (kind, key) not in self.explained:
                self.explained.add((kind, key))
                comment = COMMENTS[kind][key].strip().format(**values | details)
                aligned = f"{line:<{COMMENT_COLUMN - 1}} # {comment}"
                if len(aligned) <= WIDTH + 2 and "\n" not in line:
                    line = aligned
                else:
                    self.comment(comment)
            self.lines += line.split("\n")
        self.lines.append("")


def scene_text(proposal: Proposal, name: str, folder: Path, welds: str | None = None, points: str | None = None) -> str:
    """The scene file of a proposal.

    Parameters
    ----------
    proposal : Proposal
    name : str
    folder : Path
        Folder of the file, to which mesh names are relative.
    welds, points : str, optional
        CSV files in that folder with the welds and the points to measure.
    """
    file = _SceneFile()
    file.section("scene")
    file.lines.append("")
    file.table("scene", {"name": name, "description": "Proposed from the meshes."})
    for sentence in proposal.sentences:
        file.comment(f"NOTE: {sentence}.")
    _add_parts(file, proposal, folder)
    _add_locators(file, proposal)
    _add_zones(file, proposal)
    _add_clamps(file, proposal)
    _add_welds(file, proposal, welds)
    _add_stages(file, proposal, welds)
    _add_deviations(file, proposal)
    _add_measurements(file, proposal, points)
    file.section("monte_carlo")
    file.table("monte_carlo", {"samples": SAMPLES, "seed": 1})
    file.section("report")
    file.table("report", {"laws": ["coulomb"], "fields": True})
    return "\n".join(file.lines).rstrip() + "\n"


def _add_parts(file: _SceneFile, proposal: Proposal, folder: Path) -> None:
    file.section("parts")
    for body in proposal.bodies:
        mesh = Path(os.path.relpath(body.file.resolve(), folder.resolve())).as_posix()
        values: dict[str, Any] = {"name": body.name, "mesh": mesh}
        if body.sets:
            values["set"] = body.sets[0] if len(body.sets) == 1 else list(body.sets)
        if body.unit != "mm":
            values["unit"] = body.unit
        values |= {key: _number(getattr(body, key)) for key in ("thickness", "young", "poisson")}
        offset = proposal.offsets[body.name]
        if offset:
            values["offset"] = round(offset, 4)
        file.table(
            "parts",
            values,
            f"{len(body.surface.points)} nodes, {_size(body)}",
            thickness_from=body.thickness_from,
            material_from=body.material_from,
            reason=proposal.why.get(body.name, ""),
        )


def _size(body: Body) -> str:
    return " × ".join(f"{size:.0f}" for size in np.ptp(body.surface.points, axis=0)) + " mm"


def _add_locators(file: _SceneFile, proposal: Proposal) -> None:
    file.section("locators")
    for name, supports in proposal.fixtures.items():
        file.comment(
            f"{name}: conditioning of its six locators (ratio of the smallest to the largest singular value) is "
            f"{proposal.conditioned[name]:.2f}; 0 means a free motion."
        )
        for label, support in zip(_labels(supports), supports):
            place = "hole" if support.hole else "point"
            values: dict[str, Any] = {
                "name": f"{name}-{label}",
                "part": name,
                place: _point(support.point),
                "direction": support.direction_text,
            }
            if not support.hole:
                values["radius"] = 4
            file.table("locators", values | {"stage": "clamp" if support.further else "locate"})


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


def _add_zones(file: _SceneFile, proposal: Proposal) -> None:
    if proposal.laps:
        file.section("zones")
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
        file.table("zones", values, note, drawn=-gap.min())


def _add_clamps(file: _SceneFile, proposal: Proposal) -> None:
    if proposal.tongs:
        file.section("clamps")
    for number, tong in enumerate(proposal.tongs, 1):
        values = {
            "name": f"T{number}",
            "parts": [tong.first.name, tong.second.name],
            "point": _point(tong.point),
            "force": _number(force(tong.first, tong.second)),
        }
        file.table("clamps", values)


def _add_welds(file: _SceneFile, proposal: Proposal, welds: str | None) -> None:
    joined = [(lap, joints.welds) for lap, joints in zip(proposal.laps, proposal.joints) if len(joints.welds)]
    if welds is not None or joined:
        file.section("welds")
    if welds is not None:
        file.table("welds", {"file": welds, "radius": NUGGET})
        return
    for number, (lap, points) in enumerate(joined, 1):
        values = {
            "name": f"W{number}",
            "parts": lap.names,
            "points": [_point(point) for point in points],
            "radius": NUGGET,
        }
        file.table("welds", values)


def _add_stages(file: _SceneFile, proposal: Proposal, welds: str | None) -> None:
    file.section("stages")
    file.table("stages", {"kind": "locate"})
    clamped = bool(proposal.tongs) or any(
        support.further for supports in proposal.fixtures.values() for support in supports
    )
    welded = welds is not None or any(len(joints.welds) for joints in proposal.joints)
    if clamped:
        file.table("stages", {"kind": "clamp"}, "further locators close, then one clamp after the other")
    if welded:
        file.table("stages", {"kind": "weld"}, "all welds at once; one by one with `sequence = true`")
    if clamped or welded:
        keep = [f"{name}-{label}" for name in proposal.base for label in _labels(proposal.fixtures[name])[:6]]
        file.table("stages", {"kind": "release", "keep": keep}, "springback")
    file.table("stages", {"kind": "measure"}, "reads the measurements")


def _add_deviations(file: _SceneFile, proposal: Proposal) -> None:
    file.section("deviations")
    for name, shaping in proposal.shaping.items():
        values = {
            "name": f"{name}-shape",
            "kind": "force",
            "part": name,
            "point": _point(shaping.point),
            "direction": "normal",
            "sigma": _number(shaping.sigma),
        }
        file.table("deviations", values)
        labels = _labels(proposal.fixtures[name])
        for label in (labels[0], labels[5]):
            target = f"{name}-{label}"
            values = {"name": f"{target}-off", "kind": "locator", "target": target, "sigma": 0.1}
            file.table("deviations", values, "standard deviation in mm")


def _add_measurements(file: _SceneFile, proposal: Proposal, points: str | None) -> None:
    limits = {"lower": -LIMIT, "upper": LIMIT}
    file.section("measurements")
    if points is not None:
        file.table("measurements", {"file": points, **limits})
        return
    for part, measured in proposal.measured.items():
        for number, point in enumerate(measured, 1):
            values = {"name": f"{part}-M{number}", "part": part, "point": _point(point), "direction": "normal"}
            file.table("measurements", values | limits)


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
