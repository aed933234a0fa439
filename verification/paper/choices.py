"""Choices that the paper does not state, each varied alone about the scene `table1.toml`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic import load_scene
from mic.examples import folder
from mic.geometry.script import load_script
from mic.scene import Scene
from mic.statistics.draw import draw
from mic.studies.order import variants
from verification.order.study import ORDERS, spread
from verification.plots import panels
from verification.scenes import with_path

LAW, BASE = "associated", "nearest set"
SAMPLES, FEW = 50, 6  # of a choice; with candidates
NO_FRICTION = 1e-4  # coefficient at which slip under load is that without friction
SPACING = 6.0  # mm between contact candidates
OVERBENT_AT, MID, EDGE, ROOT = 4.0, 12.0, 18.0, 6.0  # degrees between points; mm from the flange's root


@dataclass(frozen=True)
class Choice:
    """One way to fill in what the paper leaves open.

    Attributes
    ----------
    subject, name : str
    change : callable
        Takes the scene of the nearest set, returns that of the choice.
    law : str
        Law of the frictional samples.
    quantity : {"all pairs", "loaded pairs", "slip under load"}
        RMS tangential displacement of all pairs, or of those that carry force in most frictional samples; or RMS slip
        under load.
    """

    subject: str
    name: str
    change: Callable[[Scene], Scene] = lambda scene: scene
    law: str = LAW
    quantity: str = "all pairs"


def nearest(size) -> Scene:
    """The scene `table1.toml` at a mesh size."""
    scene = load_scene(folder("wheelhouse") / "table1.toml")
    parts = [part.model_copy(update={"size": size}) for part in scene.parts]
    laws = scene.report.model_copy(update={"laws": ["associated", "coulomb", "frictionless"]})
    return scene.model_copy(update={"parts": parts, "report": laws})


def _each(scene: Scene, table: str, **keys) -> Scene:
    """The scene with keys of every item of a table changed."""
    return scene.model_copy(update={table: [item.model_copy(update=keys) for item in getattr(scene, table)]})


def _ordered(name: str) -> Callable[[Scene], Scene]:
    """The scene in an order of `verification/order/orders.toml`."""
    return lambda scene: next(order.scene for order in variants(scene, ORDERS) if order.name == name)


def _zone_by_zone(scene: Scene) -> Scene:
    """The scene in the order of `scene.toml`."""
    return scene.model_copy(update={"stages": load_scene(folder("wheelhouse")).stages})


def _pressed_at(height: float) -> Callable[[Scene], Scene]:
    """The scene with clamps at a distance from the flange's root, mm."""

    def change(scene: Scene) -> Scene:
        shape, clamps = load_script(folder("wheelhouse") / "geometry.py"), []
        for clamp in scene.clamps:
            zone, number, part = clamp.name.split("-")
            sides = shape.flange_point(shape.CLAMPS[zone][int(number) - 1], height)
            clamps.append(clamp.model_copy(update={"point": tuple(sides[part == "outer"].tolist()), "radius": 5.0}))
        return scene.model_copy(update={"clamps": clamps})

    return change


def _overbent(edge: float) -> Callable[[Scene], Scene]:
    """The scene with both flanges bent towards each other by `edge` mm at their edges (negative: apart)."""

    def change(scene: Scene) -> Scene:
        shape = load_script(folder("wheelhouse") / "geometry.py")
        angles = np.arange(shape.ARCH_START + 1.0, shape.ARCH_END, OVERBENT_AT)
        table = scene.model_dump(mode="json")
        for side, (part, region, beyond) in enumerate((("inner", "tread", 0.05), ("outer", "panel", 0.12))):
            points = [shape.surface_point(part, region, angles, beyond)[0]]
            points += [shape.flange_point(angles, height)[side] for height in (1.0, MID, 22.5)]
            values = np.repeat([0.0, 1.0, MID, 22.5], len(angles)) * (edge, -edge)[side] / shape.FLANGE_WIDTH
            bent = {"name": f"{part}-bent", "kind": "shape", "part": part, "mean": 1.0, "sigma": 0.0}
            table["deviations"].append(bent | {"points": np.concatenate(points).tolist(), "values": values.tolist()})
        return Scene(**table).model_copy(update={"folder": scene.folder})

    return change


def _independent(scene: Scene) -> Scene:
    """The scene with the independent corrective forces of `scene.toml`."""
    return scene.model_copy(update={"correlations": [], "deviations": load_scene(folder("wheelhouse")).deviations})


CHOICES = (
    Choice(BASE, "table1.toml"),
    Choice("order of closing", "zone by zone, then A4-A8", _zone_by_zone),
    Choice("order of closing", "clamps and A4-A8 together", _ordered("all together")),
    Choice("order of closing", "A4-A8, then clamps", _ordered("A4-A8, then clamps one by one")),
    Choice("clamps", "pads of 5 mm", lambda scene: _each(scene, "clamps", radius=5.0)),
    Choice("clamps", "pads of 5 mm at the edge", _pressed_at(EDGE)),
    Choice("clamps", "pads of 5 mm at the root", _pressed_at(ROOT)),
    Choice("clamps", "60 N", lambda scene: _each(scene, "clamps", force=60.0)),
    Choice("clamps", "400 N", lambda scene: _each(scene, "clamps", force=400.0)),
    Choice("clamps", "to nominal position", lambda scene: _each(scene, "clamps", force=None, stroke=0.0)),
    Choice("fit of the flange", "gap of 0.3 mm", lambda scene: _each(scene, "zones", gap=0.3)),
    Choice("fit of the flange", "gap of 1 mm", lambda scene: _each(scene, "zones", gap=1.0)),
    Choice("fit of the flange", "edges overbent 0.2 mm", _overbent(0.2)),
    Choice("fit of the flange", "edges overbent 0.8 mm", _overbent(0.8)),
    Choice("fit of the flange", "edges sprung open 0.4 mm", _overbent(-0.4)),
    Choice("pairs", "102, evenly spread", lambda scene: _each(scene, "zones", points=None, pairs=34)),
    Choice("pairs", "candidates", lambda scene: _each(scene, "zones", points=None, spacing=SPACING)),
    Choice("law and path", "(13), one increment", lambda scene: with_path(scene, "one-step")),
    Choice("law and path", "(13), 16 a step", lambda scene: with_path(scene, "increments", 16)),
    Choice("law and path", "Coulomb, one increment", lambda scene: with_path(scene, "one-step"), "coulomb"),
    Choice("law and path", "Coulomb, followed", law="coulomb"),
    Choice("what is called slip", "displacement of loaded pairs", quantity="loaded pairs"),
    Choice("what is called slip", "slip under load (Coulomb)", law="coulomb", quantity="slip under load"),
    Choice("scatter", "independent forces", _independent),
)


def zone_values(model, displacement, counted=None) -> np.ndarray:
    """(n, zones) root mean squares over the counted pairs of each zone of tangential displacements (n, m, 2), mm."""
    counted = np.ones(len(model.contacts.zone), dtype=bool) if counted is None else counted
    square = (displacement**2).sum(-1)
    zones = range(len(model.scene.zones))
    return np.column_stack([np.sqrt(square[:, counted & (model.contacts.zone == z)].mean(1)) for z in zones])


def distance(found, published) -> tuple[float, float]:
    """Root mean square and largest |ln(found / published)| of the twelve numbers of Table 1."""
    off = np.log(np.asarray(found) / np.asarray(published))
    return float(np.sqrt((off**2).mean())), float(np.abs(off).max())


def measure(model, choice: Choice, deviations, published) -> dict:
    """Ratios with and without friction of a choice, its distance to Table 1, and what its contacts carry.

    Parameters
    ----------
    deviations : (n, p) array
    published : (2, 2, zones) array
        Mean and 6σ, without and with friction, mm.
    """
    smooth, rubbing = (model.evaluate(deviations, law) for law in ("frictionless", choice.law))
    if choice.quantity == "slip under load":
        smooth = model.evaluate(deviations, choice.law, friction=NO_FRICTION)
    valid = ~(smooth.failed | rubbing.failed)
    ends = [each.resolutions["clamp"] for each in (smooth, rubbing)]
    carries = (ends[1].force[valid, :, 0] > 0).mean(0) > 0.5
    if choice.quantity == "slip under load":
        moved = [end.trace.slip[valid] for end in ends]
    else:
        moved = [end.displacement[valid][:, :, 1:] for end in ends]
    counted = carries if choice.quantity == "loaded pairs" else None
    table = np.stack([spread(zone_values(model, each, counted)) for each in moved])
    names = [zone.name for zone in model.scene.zones]
    normal = [[end.force[valid][:, model.contacts.zone == z, 0].sum(1).mean() for z in range(3)] for end in ends]
    rms, most = distance(table, published)
    row = {"subject": choice.subject, "choice": choice.name}
    for kind, ratio in zip(("mean", "6σ"), table[1] / table[0]):
        row |= {f"{name} {kind}": value for name, value in zip(names, ratio)}
    return row | {
        "distance (RMS)": rms,
        "largest": most,
        "pairs that carry": int(carries.sum()),
        "of": len(carries),
        "deepest penetration, mm": float(ends[1].unseen[valid].max(initial=0.0)),
        **{f"{name} normal force": after / before for name, before, after in zip(names, *normal)},
        "failed samples": int((~valid).sum()),
    }


def sampled(scene: Scene, base: Scene, count: int) -> np.ndarray:
    """(count, p) deviations of a choice: those of the nearest set, and the means of what the choice adds."""
    design = base.monte_carlo.model_copy(update={"design": "latin-hypercube"})  # 6σ of few samples
    base, scene = (each.model_copy(update={"monte_carlo": design}) for each in (base, scene))
    if not scene.correlations:
        return draw(scene, 404, 0, count)
    added = [item.mean for item in scene.deviations[len(base.deviations) :]]
    return np.column_stack([draw(base, 404, 0, count), np.tile(added, (count, 1))])


def study(context, size, published, listed=CHOICES) -> pd.DataFrame:
    """One row for each choice listed."""
    base = nearest(size)

    def row(choice: Choice) -> dict:
        scene = choice.change(base)
        deviations = sampled(scene, base, SAMPLES)
        if not scene.zones[0].candidates:
            return measure(context.model(scene), choice, deviations, published)
        # 6σ of so few samples says nothing by itself; its ratio does, as the samples are the same
        unknown = {"distance (RMS)": np.nan, "largest": np.nan}
        return measure(context.model(scene), choice, deviations[:FEW], published) | unknown

    return pd.DataFrame(context.team.map(row, listed))


def picture(table: pd.DataFrame, zones, published):
    """Figure of the ratios of each choice; dotted lines are the paper's."""
    figure, axes = panels(2, width=6.0, height=6.2)
    ratios = published[1] / published[0]
    for axis, kind, paper in zip(axes, ("mean", "6σ"), ratios):
        for z, zone in enumerate(zones):
            axis.plot(
                table[f"{zone} {kind}"], np.arange(len(table)) + 0.2 * (z - 1), "o", ms=4, color=f"C{z}", label=zone
            )
            axis.axvline(paper[z], color=f"C{z}", ls=":", lw=1, label=f"{zone}, paper")
        for y in np.flatnonzero(table["subject"].ne(table["subject"].shift()))[1:]:
            axis.axhline(y - 0.5, color="0.85", lw=0.8)
        axis.set(xlabel=f"{kind}, friction / none", yticks=range(len(table)), xlim=(0, None))
        axis.set_yticklabels(table["choice"] if kind == "mean" else [])
        axis.invert_yaxis()
    axes[1].legend(fontsize=7.5, loc="lower right")
    return figure
