"""Joint adjustment of individual assemblies, compared with a plan that ignores friction, and with no adjustment.

python benchmarks/adjustment.py                                  # the wheelhouse, all locators but the datum, ±1 mm
python benchmarks/adjustment.py SCENE --shim 0.5 --assemblies 200 --objective rms --names NAME NAME

The frictionless twin plans without friction, from the same bounds and steps, and its plan is evaluated with contact and
friction; so is that of the linear twin, which is frictionless and linear: it plans with the derivatives of the mean
assembly. *Common* is one set of adjustments for all assemblies.
"""

import argparse
import time

import numpy as np

import mic
from mic import examples
from mic.statistics.draw import draw
from mic.studies.adjustable import Adjustable
from mic.studies.adjustment import adjustments, with_adjustments
from mic.studies.adjustment_goals import NearTarget
from mic.studies.joint_adjustment import JointAdjustment


def main():
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("scene", nargs="?", default=examples.folder("wheelhouse"))
    asked.add_argument("--shim", type=float, default=1.0)
    asked.add_argument("--assemblies", type=int, default=30)
    asked.add_argument("--objective", default="rms")
    asked.add_argument("--seed", type=int, default=99)
    asked.add_argument("--names", nargs="*")
    given = asked.parse_args()
    model = mic.reduce(mic.load_scene(given.scene))
    locators = [item.targets[0] for item in adjustments(model, given.shim) if item.kind == "locator"]
    request = Adjustable(given.names or locators, given.shim, objective=given.objective)
    x = draw(model.scene, given.seed, 0, given.assemblies)
    start = time.process_time()
    planner = JointAdjustment(model, "coulomb", request)
    print(f"{len(planner.allowed.settings)} adjustments; set-up {time.process_time() - start:.1f} CPU s", flush=True)
    exact = with_adjustments(model, planner.allowed.settings)[0].process("coulomb")

    def evaluated(changes):
        evaluation = exact.attempt(np.column_stack([x, changes]))
        bad = evaluation.failed | ~evaluation.built
        return np.where(bad[:, None], np.nan, evaluation.measurements)

    still = np.zeros((len(x), len(planner.common)))
    before = evaluated(still)
    show(model.scene, "nothing", before, before)
    show(model.scene, "common", before, evaluated(still + planner.common))
    plans = {"joint": planner, "frictionless twin": JointAdjustment(model, "frictionless", request)}
    for name, plan in plans.items():
        changes, seconds, worst = still.copy(), [], 0.0
        for i, one in enumerate(x):
            start = time.process_time()
            proposed = plan.propose(one, np.zeros(before.shape[1]))
            seconds.append(time.process_time() - start)
            for item, change in proposed.changes.items():
                changes[i, plan.allowed.settings.index(item)] = change
            worst = max(worst, proposed.residual)
        show(model.scene, name, before, evaluated(changes))
        print(
            f"    {np.mean(seconds):.2f} CPU s an assembly, at most {np.max(seconds):.2f}; residual at most {worst:.1e}"
        )
    show(model.scene, "linear twin", before, evaluated(linear_plan(model, planner, x)))


def linear_plan(model, planner, x):
    """(n, a) changes by the derivatives of the frictionless mean assembly, towards the middle of the limits."""
    settings = planner.allowed.settings
    extended, names = with_adjustments(model, settings)
    found = extended.sensitivities({}, "frictionless", [*extended.parameters])
    a = len(names)
    slope, mean = found.jacobian[0], extended.deviations({})[0]
    size = np.array([item.size for item in settings])
    goal = NearTarget(*middle_and_weight(model.scene), np.zeros(a), size)
    bounds = np.array([(item.low, item.high) for item in settings]).T
    changes = []
    for one in x:
        y = found.measurements[0] + slope[:, :-a] @ (one - mean[:-a])
        step = goal.step(y[None], slope[None, :, -a:], np.zeros(a), *bounds)
        rounded = [np.round(change / item.step) * item.step for change, item in zip(step, settings)]
        changes.append(np.clip(rounded, *bounds))
    return np.array(changes)


def middle_and_weight(scene):
    """Middle of the limits, mm, and the inverse of half the tolerances, 1/mm."""
    lower, upper = np.array([(item.lower, item.upper) for item in scene.measurements]).T
    return (lower + upper) / 2, 2 / (upper - lower)


def show(scene, name, before, after):
    """Print what is left of variation, RMS deviation and mean, and the share of characteristics within limits."""
    middle, weight = middle_and_weight(scene)
    known = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    a, b = ((y[known] - middle) * weight for y in (before, after))
    size = lambda y: np.sqrt(np.mean(y**2))
    each = np.sqrt((b**2).mean(axis=1)) > np.sqrt((a**2).mean(axis=1)) * (1 + 1e-9)
    print(
        f"{name}: variation left {size(b - b.mean(axis=0)) / size(a - a.mean(axis=0)):.3f}, RMS deviation left "
        f"{size(b) / size(a):.3f}, mean left {np.abs(b.mean(axis=0)).mean() / np.abs(a.mean(axis=0)).mean():.3f}, "
        f"within limits {(np.abs(b) <= 1).mean():.4f}, worse than nothing {int(each.sum())} of {known.sum()}, "
        f"not buildable {int((~known).sum())}",
        flush=True,
    )


if __name__ == "__main__":
    main()
