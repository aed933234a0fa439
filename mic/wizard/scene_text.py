"""A proposal as the text of a scene file that explains itself."""

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
LIMIT = 0.5  # mm: a tolerance to begin with
SAMPLES = 100
FRICTION = 0.2

Row = tuple[str, Any, str]  #: key, value, what it means


class _Page:
    """Lines of a scene file: the first table of each kind has a comment on every line, the others where they differ."""

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
        Where the file will stand: mesh files are named from there.
    welds, points : str, optional
        CSV files in that folder that list the welds, and the points to measure.
    """
    page = _Page()
    page.say(
        "A first scene, proposed by mic init from the meshes alone. Everything here is a guess but what the meshes "
        "tell: go through it from top to bottom and put in what you know. Lengths are mm, forces N, stiffness MPa. "
        "`mic check` says what the scene means and what is wrong with it, `mic run` computes it. The scene reference "
        "of the documentation has every key."
    )
    page.blank()
    page.table(
        "",
        [
            ("name", name, "names the folder of the results"),
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
    page.say("What the run shall produce; what is not asked for is not computed.")
    page.table(
        "[report]",
        [
            ("laws", ["coulomb"], 'laws of contact; add "frictionless" to see what friction does'),
            ("fields", True, "mean and 6σ displacement of the whole assembly"),
        ],
    )
    return "\n".join(page.lines).rstrip() + "\n"


def _parts(page: _Page, proposal: Proposal, folder: Path) -> None:
    page.say("--- Parts: sheets, each by the mesh of one of its surfaces, mostly the middle one.")
    for body in proposal.bodies:
        rows: list[Row] = [
            ("name", body.name, "names the part in every other table"),
            (
                "mesh",
                Path(os.path.relpath(body.file.resolve(), folder.resolve())).as_posix(),
                "from this file's folder",
            ),
        ]
        if body.sets:
            value = body.sets[0] if len(body.sets) == 1 else list(body.sets)
            rows.append(("set", value, "the element set of the mesh file that is this part"))
        if body.unit != "mm":
            rows.append(("unit", body.unit, "of the mesh file"))
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
                "thicknesses from the drawn surface to the middle of the sheet, along the mesh's normals: "
                + proposal.why[body.name],
            )
        )
    return rows


def _size(body: Body) -> str:
    return " × ".join(f"{size:.0f}" for size in np.ptp(body.surface.points, axis=0)) + " mm"


def _locators(page: _Page, proposal: Proposal) -> None:
    page.say(
        '--- Locators: each holds a part in one direction, over a round pad. The six of stage "locate" set a part '
        "down: three along the sheet's normal (A), two across it (B), one along it (C). Further ones close in stage "
        '"clamp" and bend the part to its nominal shape there.'
    )
    for body in proposal.bodies:
        own = proposal.fixtures[body.name]
        page.say(
            f"{body.name}: how well the six hold it, the ratio of the least to the largest singular value of its rigid "
            f"motions' readings, is {proposal.conditioned[body.name]:.2f} (0 would be loose)."
        )
        for label, one in zip(_labels(own), own):
            where: Row = ("point", _point(one.point), "where, mm")
            if one.hole:
                where = ("hole", _point(one.point), "a pin in the hole about this point, mm: the rim is read")
            rows: list[Row] = [
                ("name", f"{body.name}-{label}", "names it in `keep` and in deviations"),
                ("part", body.name, "the part that it holds"),
                where,
                ("direction", one.words, '"normal" to the sheet, an axis laid into it ("in-plane x"), or [x, y, z]'),
            ]
            if not one.hole:
                rows.append(("radius", 4, "of the pad, mm"))
            rows.append(("stage", "clamp" if one.further else "locate", "when it closes"))
            page.table("[[locators]]", rows)


def _labels(supports: Sequence[Support]) -> list[str]:
    """A1, A2, A3, B1, B2, C1 of a 3-2-1; A4 and so on beyond; L1 to L6 of six rows that are none."""
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
    page.say("--- Contact zones: where two parts may touch. A zone finds by itself where they face each other.")
    for lap, overlap, reach in zip(proposal.laps, proposal.overlap, proposal.reach):
        a, b = lap.first.name, lap.second.name
        gap = lap.gap(proposal.offsets)
        rows: list[Row] = [
            ("name", f"{a}-{b}", "names it in the results"),
            ("parts", [a, b], "the two that may touch"),
            ("friction", FRICTION, "coefficient of friction; 0.1 to 0.3 for sheet metal, oiled to dry"),
        ]
        if overlap:
            rows.append(
                (
                    "nominal_overlap",
                    overlap,
                    f"mm: the sheets are drawn {-gap.min():.2f} mm into each other here, which counts as touching up "
                    "to this; thicknesses or offsets may be wrong",
                )
            )
        if reach:
            rows.append(("max_gap", reach, "mm between them; where they lie farther apart, another sheet lies between"))
        if proposal.spacing is not None:
            rows.append(
                (
                    "spacing",
                    _number(proposal.spacing),
                    "mm between candidates for contact: so that a first run takes minutes; take it out for the last",
                )
            )
        told = f"{lap.area:.0f} mm², drawn gaps {gap.min() + 0.0:.2f} to {gap.max() + 0.0:.2f} mm"
        page.table("[[zones]]", rows, told)


def _clamps(page: _Page, proposal: Proposal) -> None:
    if not proposal.tongs:
        return
    page.say(
        "--- Clamps: tongs press two parts together by a force; a clamp on one `part` pushes it along a direction."
    )
    for count, tong in enumerate(proposal.tongs, 1):
        rows: list[Row] = [
            ("name", f"T{count}", "names it in `order` and in deviations"),
            ("parts", [tong.first.name, tong.second.name], "the two that it presses together"),
            ("point", _point(tong.point), "where, mm"),
            ("force", _number(force(tong.first, tong.second)), "N"),
        ]
        page.table("[[clamps]]", rows)


def _welds(page: _Page, proposal: Proposal, file: str | None) -> None:
    if file is not None:
        page.say("--- Spot welds: one a row of a CSV file, whose columns are keys.")
        page.table(
            "[[welds]]",
            [("file", file, "columns name, parts, x, y, z"), ("radius", 2.5, "of the nuggets, mm")],
        )
        return
    if not any(len(joint.welds) for joint in proposal.joints):
        return
    page.say(
        "--- Spot welds: each freezes the gap that it finds; `points` is one at each. Hundreds come from a CSV file."
    )
    count = 0
    for lap, joint in zip(proposal.laps, proposal.joints):
        if len(joint.welds):
            count += 1
            rows: list[Row] = [
                ("name", f"W{count}", f"they are called W{count}-1, W{count}-2, …"),
                ("parts", [lap.first.name, lap.second.name], "the two that they join"),
                ("points", [_point(point) for point in joint.welds], "where, mm"),
                ("radius", 2.5, "of the nuggets, mm"),
            ]
            page.table("[[welds]]", rows)


def _stages(page: _Page, proposal: Proposal, welds: str | None) -> None:
    page.say("--- The process, stage after stage. `mic check` prints it step by step.")
    page.table("[[stages]]", [("kind", "locate", "the parts are set down on their six locators")])
    further = any(one.further for own in proposal.fixtures.values() for one in own)
    tongs = bool(proposal.tongs)
    welded = welds is not None or any(len(joint.welds) for joint in proposal.joints)
    if further or tongs:
        page.table("[[stages]]", [("kind", "clamp", "")], "further locators close, then one clamp after the other")
    if welded:
        page.table("[[stages]]", [("kind", "weld", "")], "all welds at once; `sequence = true`: one by one")
    if further or tongs or welded:
        keep = [f"{name}-{label}" for name in proposal.base for label in _labels(proposal.fixtures[name])[:6]]
        page.table(
            "[[stages]]",
            [("kind", "release", ""), ("keep", keep, "all opens but these: what is measured springs back on them")],
            "springback",
        )
    page.table("[[stages]]", [("kind", "measure", "")], "reads the measurements")


def _deviations(page: _Page, proposal: Proposal) -> None:
    page.say(
        "--- Deviations: what varies from assembly to assembly, each on its own. These are placeholders, so that a "
        "first run says something: put in what your parts and fixtures do. A corrective force gives a part another "
        "stress-free shape; a locator that is off moves its part."
    )
    for body in proposal.bodies:
        shaping = proposal.shaping[body.name]
        page.table(
            "[[deviations]]",
            [
                ("name", f"{body.name}-shape", "names it in the results"),
                ("kind", "force", '"force": shapes a part; "locator", "clamp": moves one'),
                ("part", body.name, "the part that it shapes"),
                ("point", _point(shaping.point), "where the force acts, mm"),
                ("direction", "normal", "into which it acts"),
                ("sigma", _number(shaping.sigma), "standard deviation, N: a flat sheet would move by about 0.3 mm"),
            ],
        )
        labels = _labels(proposal.fixtures[body.name])
        for label in (labels[0], labels[5]):
            page.table(
                "[[deviations]]",
                [
                    ("name", f"{body.name}-{label}-off", ""),
                    ("kind", "locator", ""),
                    ("target", f"{body.name}-{label}", "the locator that moves along its direction"),
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
        rows: list[Row] = [("file", file, "one a row; columns are keys, and come before what stands here"), *limits]
        page.table("[[measurements]]", rows)
        return
    for body in proposal.bodies:
        for number, point in enumerate(proposal.measured[body.name], 1):
            page.table(
                "[[measurements]]",
                [
                    ("name", f"{body.name}-M{number}", "names it in the results"),
                    ("part", body.name, "the part that is measured"),
                    ("point", _point(point), "where, mm: at a free edge"),
                    ("direction", "normal", "in which the deviation counts positive"),
                    *limits,
                ],
            )


def _point(point: np.ndarray) -> list[float]:
    return [round(float(value), 2) + 0.0 for value in point]


def _number(value: float) -> float | int:
    value = float(f"{value:.6g}")
    return int(value) if value == int(value) else value


def _value(value: Any) -> str:
    """A value as TOML has it; long lists over several lines."""
    text = json.dumps(value, ensure_ascii=False)
    if isinstance(value, list) and len(text) > 90:
        return "[\n" + "".join(f"    {json.dumps(one, ensure_ascii=False)},\n" for one in value) + "]"
    return text
