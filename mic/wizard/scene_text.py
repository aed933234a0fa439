"""Write a proposal as a scene file with comments."""

from __future__ import annotations

import json
import os
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
LIMIT = 0.5  # mm
SAMPLES = 100
FRICTION = 0.2

Row = tuple[str, Any, str]  #: key, value, comment


class _Page:
    """Lines of a scene file; each key is explained where it first occurs in a kind of table."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.explained: set[tuple[str, str]] = set()

    def say(self, text: str) -> None:
        """A paragraph of comment."""
        line = "#"
        for word in text.split():
            if len(line) + 1 + len(word) > WIDTH:
                self.lines.append(line)
                line = "#"
            line += f" {word}"
        self.lines.append(line)

    def blank(self) -> None:
        self.lines.append("")

    def table(self, head: str, rows: Sequence[Row], why: str = "") -> None:
        """A table, or one more of a list of tables."""
        if head:
            self.lines.append(f"{head}  # {why}" if why else head)
        for key, value, meaning in rows:
            line = f"{key} = {_value(value)}"
            if meaning and (head, key) not in self.explained:
                pad = max(1, 44 - len(line))
                if len(line) + pad + 2 + len(meaning) > 120 or "\n" in line:
                    self.say(meaning)
                else:
                    line += f"{' ' * pad}# {meaning}"
                self.explained.add((head, key))
            self.lines += line.split("\n")
        self.blank()


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
    page = _Page()
    page.say(
        "A first scene, proposed by mic init from the meshes alone. All values that the meshes do not contain are "
        "guesses: go through the file and correct them. Units are mm, N, MPa. `mic check` explains the scene and lists "
        "its errors, `mic run` computes it. The scene reference in the documentation has all keys."
    )
    page.blank()
    page.table(
        "",
        [
            ("name", name, "name of the results folder"),
            ("description", "Proposed from the meshes.", "one sentence for the report"),
        ],
    )
    for sentence in proposal.sentences:
        page.say(f"NOTE: {sentence}.")
    _parts(page, proposal, folder)
    _locators(page, proposal)
    _zones(page, proposal)
    _clamps(page, proposal)
    _welds(page, proposal, welds)
    _stages(page, proposal, welds)
    _deviations(page, proposal)
    _measurements(page, proposal, points)
    page.say("Size of the Monte Carlo: 500 samples leave a standard deviation uncertain by 6 %, 100 by 14 %.")
    page.table("[monte_carlo]", [("samples", SAMPLES, "number of assemblies"), ("seed", 1, "of the deviations")])
    page.say("Requested results; others are not computed.")
    page.table(
        "[report]",
        [
            ("laws", ["coulomb"], 'contact laws; add "frictionless" to see the effect of friction'),
            ("fields", True, "mean and 6σ displacement of the whole assembly"),
        ],
    )
    return "\n".join(page.lines).rstrip() + "\n"


def _parts(page: _Page, proposal: Proposal, folder: Path) -> None:
    page.say("--- Parts: sheets, each with the mesh of a surface, usually the mid-surface.")
    for body in proposal.bodies:
        rows: list[Row] = [
            ("name", body.name, "name of the part in all other tables"),
            (
                "mesh",
                Path(os.path.relpath(body.file.resolve(), folder.resolve())).as_posix(),
                "relative to this file",
            ),
        ]
        if body.sets:
            value = body.sets[0] if len(body.sets) == 1 else list(body.sets)
            rows.append(("set", value, "element sets of the mesh file that form this part"))
        if body.unit != "mm":
            rows.append(("unit", body.unit, "unit of length of the mesh file"))
        page.table(
            "[[parts]]",
            [*rows, *_sheet(body, proposal)],
            f"{len(body.surface.points)} nodes, {_size(body)}",
        )


def _sheet(body: Body, proposal: Proposal) -> list[Row]:
    rows: list[Row] = [
        ("thickness", _number(body.thickness), f"mm, {body.thickness_from}"),
        ("young", _number(body.young), f"Young's modulus, MPa; {body.material_from}"),
        ("poisson", _number(body.poisson), "Poisson's ratio"),
    ]
    offset = proposal.offsets[body.name]
    if offset:
        rows.append(
            (
                "offset",
                round(offset, 4),
                "thicknesses from the drawn surface to the mid-surface, along the mesh's normals: "
                + proposal.why[body.name],
            )
        )
    return rows


def _size(body: Body) -> str:
    return " × ".join(f"{size:.0f}" for size in np.ptp(body.surface.points, axis=0)) + " mm"


def _locators(page: _Page, proposal: Proposal) -> None:
    page.say(
        '--- Locators: each holds a part in one direction, over a round pad. The six of stage "locate" place a part: '
        "three along the sheet's normal (A), two across it (B), one along it (C). Further ones close in stage "
        '"clamp" and bend the part to its nominal shape there.'
    )
    for body in proposal.bodies:
        own = proposal.fixtures[body.name]
        page.say(
            f"{body.name}: conditioning of its six locators (ratio of the smallest to the largest singular value) is "
            f"{proposal.conditioned[body.name]:.2f}; 0 means a free motion."
        )
        for label, one in zip(_labels(own), own):
            where: Row = ("point", _point(one.point), "mm")
            if one.hole:
                where = ("hole", _point(one.point), "a pin in the hole at this point, mm")
            rows: list[Row] = [
                ("name", f"{body.name}-{label}", "name in `keep` and in deviations"),
                ("part", body.name, "supported part"),
                where,
                (
                    "direction",
                    one.words,
                    '"normal" to the sheet, an axis projected into it ("in-plane x"), or [x, y, z]',
                ),
            ]
            if not one.hole:
                rows.append(("radius", 4, "of the pad, mm"))
            rows.append(("stage", "clamp" if one.further else "locate", "stage in which it closes"))
            page.table("[[locators]]", rows)


def _labels(supports: Sequence[Support]) -> list[str]:
    """A1, A2, A3, B1, B2, C1 for a 3-2-1, else L1 to L6; A4 and so on for further locators."""
    words = [one.words for one in supports[:6]]
    labels = [f"L{i}" for i in range(1, 7)]
    if words[:3] == ["normal"] * 3 and "normal" not in words[3:]:
        across = max(set(words[3:]), key=words[3:].count)
        seen = {"B": 0, "C": 0}
        labels = ["A1", "A2", "A3"]
        for word in words[3:]:
            letter = "B" if word == across else "C"
            seen[letter] += 1
            labels.append(f"{letter}{seen[letter]}")
    return labels + [f"A{i}" for i in range(4, 4 + len(supports) - 6)]


def _zones(page: _Page, proposal: Proposal) -> None:
    if not proposal.laps:
        return
    page.say("--- Contact zones: where two parts may touch. The facing surfaces are found automatically.")
    for lap, overlap, reach in zip(proposal.laps, proposal.overlap, proposal.reach):
        a, b = lap.first.name, lap.second.name
        gap = lap.gap(proposal.offsets)
        rows: list[Row] = [
            ("name", f"{a}-{b}", "name in results"),
            ("parts", [a, b], "the two parts that may touch"),
            ("friction", FRICTION, "coefficient of friction; 0.1 to 0.3 for sheet metal, oiled to dry"),
        ]
        if overlap:
            rows.append(
                (
                    "nominal_overlap",
                    overlap,
                    f"mm: overlaps up to this count as touching; the largest drawn overlap is {-gap.min():.2f} mm, so "
                    "thicknesses or offsets may be wrong",
                )
            )
        if reach:
            rows.append(("max_gap", reach, "mm; with larger gaps another sheet is between the two"))
        if proposal.spacing is not None:
            rows.append(
                (
                    "spacing",
                    _number(proposal.spacing),
                    "mm between contact candidates, for a fast first run; remove it for the final run",
                )
            )
        comment = f"{lap.area:.0f} mm², drawn gaps {gap.min() + 0.0:.2f} to {gap.max() + 0.0:.2f} mm"
        page.table("[[zones]]", rows, comment)


def _clamps(page: _Page, proposal: Proposal) -> None:
    if not proposal.tongs:
        return
    page.say(
        "--- Clamps: tongs press two parts together by a force; a clamp on one `part` pushes it along a direction."
    )
    for count, tong in enumerate(proposal.tongs, 1):
        rows: list[Row] = [
            ("name", f"T{count}", "name in `order` and in deviations"),
            ("parts", [tong.first.name, tong.second.name], "the two parts that it presses together"),
            ("point", _point(tong.point), "mm"),
            ("force", _number(force(tong.first, tong.second)), "N"),
        ]
        page.table("[[clamps]]", rows)


def _welds(page: _Page, proposal: Proposal, file: str | None) -> None:
    if file is not None:
        page.say("--- Spot welds: one per row of a CSV file, whose columns are keys.")
        page.table(
            "[[welds]]",
            [("file", file, "columns name, parts, x, y, z"), ("radius", 2.5, "radius of the nuggets, mm")],
        )
        return
    if not any(len(joint.welds) for joint in proposal.joints):
        return
    page.say(
        "--- Spot welds, one at each of `points`; each freezes the gap at its point. Many welds can be in a CSV file."
    )
    count = 0
    for lap, joint in zip(proposal.laps, proposal.joints):
        if len(joint.welds):
            count += 1
            rows: list[Row] = [
                ("name", f"W{count}", f"the welds are W{count}-1, W{count}-2, …"),
                ("parts", [lap.first.name, lap.second.name], "the two parts that they join"),
                ("points", [_point(point) for point in joint.welds], "mm"),
                ("radius", 2.5, "radius of the nuggets, mm"),
            ]
            page.table("[[welds]]", rows)


def _stages(page: _Page, proposal: Proposal, welds: str | None) -> None:
    page.say("--- The stages of the process. `mic check` prints their steps.")
    page.table("[[stages]]", [("kind", "locate", "places the parts on their six locators")])
    further = any(one.further for own in proposal.fixtures.values() for one in own)
    tongs = bool(proposal.tongs)
    welded = welds is not None or any(len(joint.welds) for joint in proposal.joints)
    if further or tongs:
        page.table("[[stages]]", [("kind", "clamp", "")], "further locators close, then one clamp after the other")
    if welded:
        page.table("[[stages]]", [("kind", "weld", "")], "all welds at once; one by one with `sequence = true`")
    if further or tongs or welded:
        keep = [f"{name}-{label}" for name in proposal.base for label in _labels(proposal.fixtures[name])[:6]]
        page.table(
            "[[stages]]",
            [("kind", "release", ""), ("keep", keep, "these stay closed, all others open")],
            "springback",
        )
    page.table("[[stages]]", [("kind", "measure", "")], "reads the measurements")


def _deviations(page: _Page, proposal: Proposal) -> None:
    page.say(
        "--- Deviations: independent variations between assemblies. These are placeholders for a first run: replace "
        "them by the variations of your parts and fixtures. A corrective force gives a part another stress-free shape; "
        "a displaced locator moves its part."
    )
    for body in proposal.bodies:
        shaping = proposal.shaping[body.name]
        page.table(
            "[[deviations]]",
            [
                ("name", f"{body.name}-shape", "name in results"),
                ("kind", "force", '"force" shapes a part; "locator" and "clamp" move these'),
                ("part", body.name, "the part whose shape varies"),
                ("point", _point(shaping.point), "of the force, mm"),
                ("direction", "normal", "of the force"),
                ("sigma", _number(shaping.sigma), "standard deviation, N: deflects a flat sheet by about 0.3 mm"),
            ],
        )
        labels = _labels(proposal.fixtures[body.name])
        for label in (labels[0], labels[5]):
            page.table(
                "[[deviations]]",
                [
                    ("name", f"{body.name}-{label}-off", ""),
                    ("kind", "locator", ""),
                    ("target", f"{body.name}-{label}", "locator that moves along its direction"),
                    ("sigma", 0.1, ""),
                ],
                "standard deviation in mm",
            )


def _measurements(page: _Page, proposal: Proposal, file: str | None) -> None:
    limits: list[Row] = [
        ("lower", -LIMIT, "lower limit of the tolerance, mm from nominal"),
        ("upper", LIMIT, "upper limit"),
    ]
    page.say(
        "--- Key characteristics: the deviation of a point from nominal, and its tolerance. The limits are guesses."
    )
    if file is not None:
        rows: list[Row] = [("file", file, "one per row; columns are keys and override those below"), *limits]
        page.table("[[measurements]]", rows)
        return
    for body in proposal.bodies:
        for number, point in enumerate(proposal.measured[body.name], 1):
            page.table(
                "[[measurements]]",
                [
                    ("name", f"{body.name}-M{number}", "name in results"),
                    ("part", body.name, "measured part"),
                    ("point", _point(point), "mm, at a free edge"),
                    ("direction", "normal", "in which a deviation is positive"),
                    *limits,
                ],
            )


def _point(point: np.ndarray) -> list[float]:
    return [round(float(value), 2) + 0.0 for value in point]


def _number(value: float) -> float | int:
    value = float(f"{value:.6g}")
    return int(value) if value == int(value) else value


def _value(value: Any) -> str:
    """A value in TOML, with long lists on several lines."""
    text = json.dumps(value, ensure_ascii=False)
    if isinstance(value, list) and len(text) > 90:
        return "[\n" + "".join(f"    {json.dumps(one, ensure_ascii=False)},\n" for one in value) + "]"
    return text
