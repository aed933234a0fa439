"""Write the scene of the body side, with locators, clamps, welds and zones at the joints of its geometry.

python meshes/body_side/write.py > meshes/body_side/body_side.toml
"""

from __future__ import annotations

from geometry import FLANGE, FOOT, HAT_HEIGHT, PARTS, PILLAR, PILLARS, RAIL, RAILS, THICKNESS, WEB

SPACING = 20  # mm, between the candidates of a zone
FORCE = 150  # N, of a clamp
MIDDLE = FOOT + FLANGE / 2  # mm, of a flange, from the member's middle
HEAD = """# The side frame of a body: twelve parts that touch in 21 zones. The large case; written by write.py.

name = "body-side"
description = "Three rails and three pillars, channels closed by hats, clamped and welded."
"""
TAIL = """[monte_carlo]
samples = 50
seed = 1

[report]
laws = ["coulomb"]
"""


class Member:
    """A rail or a pillar, and the coordinates of its points."""

    def __init__(self, name: str):
        self.name, self.rail = name, name in RAILS
        self.start, self.end = RAIL if self.rail else PILLAR

    def at(self, along: float, across: float, height: float = 0.0) -> list[float]:
        """Coordinates of a point, from those along the member, across it, and above its channel's web."""
        if self.rail:
            return [along, RAILS[self.name] + across, height]
        return [PILLARS[self.name] + across, along, -THICKNESS - height]

    def share(self, share: float) -> float:
        """Coordinate along the member at a share of its length."""
        return self.start + share * (self.end - self.start)


def table(kind: str, /, **keys) -> None:
    """Print one entry of a list of tables."""
    print(f"\n[[{kind}]]")
    for key, value in keys.items():
        text = f'"{value}"' if isinstance(value, str) else str(value).replace("'", '"')
        print(f"{key} = {text}")


def main() -> None:
    """Print the scene."""
    members = [Member(name) for name in (*RAILS, *PILLARS)]
    print(HEAD, end="")
    for part in PARTS:
        table("parts", name=part, geometry="geometry.py", size="coarse", thickness=1, young=210000, poisson=0.3)
    for member in members:
        locate(member)
    for member in members:
        for side in (-1, 1):
            for i, share in enumerate((0.33, 0.67)):
                table(
                    "clamps",
                    name=f"C-{member.name}-{'lr'[side > 0]}{i + 1}",
                    parts=[f"{member.name}-hat", f"{member.name}-channel"],
                    point=member.at(member.share(share), side * MIDDLE, THICKNESS / 2),
                    force=FORCE,
                )
    for member in members:
        for side in (-1, 1):
            for i, share in enumerate((0.1, 0.37, 0.63, 0.9)):
                weld(
                    f"W-{member.name}-{'lr'[side > 0]}{i + 1}",
                    [f"{member.name}-channel", f"{member.name}-hat"],
                    member.at(member.share(share), side * MIDDLE, THICKNESS / 2),
                )
    for rail, y in RAILS.items():
        for pillar, x in PILLARS.items():
            for side in (-1, 1):
                name = f"W-{rail}-{pillar}{'lr'[side > 0]}"
                weld(name, [f"{pillar}-channel", f"{rail}-channel"], [x + 10 * side, y, -THICKNESS / 2])
    for member in members:
        for side in (-1, 1):
            ends = (side * (FOOT - 2), side * (FOOT + FLANGE + 2))
            zone(
                f"{member.name}-{'lr'[side > 0]}",
                [f"{member.name}-channel", f"{member.name}-hat"],
                member.at(member.start - 1, min(ends), -1),
                member.at(member.end + 1, max(ends), 2),
            )
    for rail, y in RAILS.items():
        for pillar, x in PILLARS.items():
            low, high = [x - WEB, y - WEB, -3.0], [x + WEB, y + WEB, 3.0]
            zone(f"{rail}-{pillar}", [f"{pillar}-channel", f"{rail}-channel"], low, high)
    groups = [[f"C-{member.name}-{side}{i}" for member in members for side in "lr"] for i in (1, 2)]
    table("stages", kind="locate")
    table("stages", kind="clamp", order=groups)
    table("stages", kind="weld")
    table("stages", kind="release", keep=[f"rocker-channel-{name}" for name in ("A1", "A2", "A3", "B1", "B2", "C1")])
    table("stages", kind="measure")
    for i, member in enumerate(members):
        for j, (sheet, height) in enumerate((("channel", 0.0), ("hat", THICKNESS + HAT_HEIGHT))):
            for k, share in enumerate((0.3, 0.7)):
                table(
                    "deviations",
                    name=f"F-{member.name}-{sheet}{k + 1}",
                    kind="force",
                    part=f"{member.name}-{sheet}",
                    point=member.at(member.share(share), 0.0, height),
                    direction=[0, 0, 1],
                    mean=(-1) ** (i + j + k) * 2,
                    sigma=2,
                )
    for member in members:
        for i, share in enumerate((0.25, 0.75)):
            table(
                "measurements",
                name=f"M-{member.name}{i + 1}",
                part=f"{member.name}-hat",
                point=member.at(member.share(share), 0.0, THICKNESS + HAT_HEIGHT),
                direction=[0, 0, 1],
                lower=-1,
                upper=1,
            )
    print(f"\n{TAIL}", end="")


def locate(member: Member) -> None:
    """The six locators of a member's channel, and of its hat."""
    along = [0, 1, 0] if not member.rail else [1, 0, 0]
    across = [1, 0, 0] if not member.rail else [0, 1, 0]
    first, middle, last = (member.share(share) for share in (0.03, 0.5, 0.97))
    edge = WEB / 2 - 4
    for sheet, rest, height in (("channel", edge, 0.0), ("hat", MIDDLE, THICKNESS)):
        six = {
            "A1": (first, rest, [0, 0, 1]),
            "A2": (first, -rest, [0, 0, 1]),
            "A3": (last, rest, [0, 0, 1]),
            "B1": (first, -rest, across),
            "B2": (last, -rest, across),
            "C1": (middle, -rest, along),
        }
        for name, (place, aside, direction) in six.items():
            table(
                "locators",
                name=f"{member.name}-{sheet}-{name}",
                part=f"{member.name}-{sheet}",
                point=member.at(place, aside, height),
                direction=direction,
            )


def weld(name: str, parts: list[str], point: list[float]) -> None:
    """A spot weld."""
    table("welds", name=name, parts=parts, point=[round(x, 3) for x in point])


def zone(name: str, parts: list[str], low: list[float], high: list[float]) -> None:
    """A zone of contact within a box."""
    box = [[min(pair) for pair in zip(low, high)], [max(pair) for pair in zip(low, high)]]
    table("zones", name=name, parts=parts, friction=0.15, spacing=SPACING, box=box)


if __name__ == "__main__":
    main()
