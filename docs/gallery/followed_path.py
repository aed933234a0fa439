"""
How a load path is followed
===========================

Friction forces depend on the way to a load. This page follows three contacts on coupled springs, shows the steps, and
names the module of `mic/contact/native` for each part of a step. The page on contact has the laws.
"""

import matplotlib.pyplot as plt
import numpy as np

from mic.contact.path import Followed
from mic.contact.solver import ContactSolver
from mic.contact.states import OPEN, SLIP, STICK, classify

# %%
# **The problem.** The compliance ``S`` gives displacements from contact forces, three entries per contact (normal, two
# tangential). Without contact forces, displacements change linearly on each leg of the path: here the contacts are
# pressed, then drawn along the first tangent, then along the second. The second contact starts open, with a gap.
# (`problem.py` scales forces and displacements; `law_equation.py` has the equation of each law.)
FRICTION = 0.3
coupling = np.array([[1.0, 0.4, 0.1], [0.4, 1.2, 0.4], [0.1, 0.4, 0.9]])
S = np.kron(coupling, np.diag([1.0, 0.8, 0.8])) * 1e-3  # mm/N
gap = np.kron([0.0, 0.02, 0.0], [1, 0, 0])
press, first, second = np.kron(np.ones(3), np.eye(3)) * [[0.1], [0.03], [0.03]]  # mm, on each contact
loads = np.array([gap, gap - press, gap - press + first, gap - press + first + second])
solver = ContactSolver(S, np.full(3, FRICTION), "coulomb")


def follow(path):
    """Ends of the steps over the whole path (k,), and the forces there (k, 3, 3)."""
    force, anchor, ends, forces = np.zeros((1, 9)), np.zeros((1, 3, 2)), [0.0], [np.zeros((3, 3))]
    for leg in range(3):
        solution = solver.follow(loads[None, leg : leg + 2], force, anchor, path)
        record = solution.record[0]
        after = record.ends > 0
        ends += list(leg + record.ends[after])
        forces += list(record.force[after].reshape(-1, 3, 3))
        force, anchor = solution.force, solution.anchor
    return np.array(ends), np.array(forces)


ends, forces = follow(Followed(recorded=True))
print(f"{len(ends) - 1} steps")

# %%
# **A step** (`path_step.py`) has four parts.
#
# 1. *Prediction* (`prediction.py`). With the states held, rates are one linear problem. `pivots.py` finds which
#    contacts on the cone slide forward; a change of state changes the kept inverse by rank 3 (`kept_inverse.py`).
#    More than 150 closed contacts have factors instead (`kept_factors.py`). The step ends behind the first contact
#    that closes.
# 2. *Slip origins* (`slip_origins.py`). Backward Euler's method measures slip from where the step began, which is of
#    first order. The origin is moved: of a slider by how far it forgets its old direction, of a closing contact by its
#    motion until it touches. That makes the step of second order.
# 3. *Solution* (`step_solution.py`). Newton's method (`newton.py`) solves the equation of the law with these origins,
#    from the prediction, with the inverse that the prediction kept.
# 4. *Error* (`step_error.py`). The solution gives other origins than the prediction. The difference estimates the error
#    of positions and forces, which determines the length of the next step or cuts this one.
#
# `follower.py` takes the steps of a leg, `step_trace.py` sums slip, work and states, and `path_derivative.py`
# differentiates the recorded steps.
#
# The figure shows the forces, the states and the error of each force against a path with a tolerance 250 times smaller.
# Few steps suffice while contacts close, stick and slide straight on; sliders whose direction turns need most of them.
exact = follow(Followed(tolerance=1e-6, recorded=True))
at_ends = [np.interp(ends, exact[0], values) for values in exact[1].reshape(-1, 9).T]
error = np.abs(forces.reshape(-1, 9) - np.transpose(at_ends)).reshape(-1, 3, 3).max(2)

figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
for contact in range(3):
    normal, tangential = forces[:, contact, 0], np.linalg.norm(forces[:, contact, 1:], axis=1)
    (line,) = top.plot(ends, FRICTION * normal, "--", lw=1)
    top.plot(ends, tangential, "o-", ms=3, color=line.get_color(), label=f"contact {contact + 1}")
    bottom.semilogy(ends, np.maximum(error[:, contact], 1e-9), "o-", ms=3, color=line.get_color())
top.set(ylabel="tangential force, N", title="dashed: friction times normal force; each point ends a step")
top.legend()

states = classify(forces, FRICTION * forces[..., 0])
colours = {OPEN: "white", STICK: "tab:gray", SLIP: "tab:orange"}
for step in range(1, len(ends)):
    for contact, state in enumerate(states[step]):
        width = ends[step] - ends[step - 1]
        middle.barh(contact + 1, width, 0.8, ends[step - 1], color=colours[state], ec="k", lw=0.3)
middle.set(ylabel="contact", yticks=[1, 2, 3], title="states: open white, stick gray, slip orange")
bottom.set(xlabel="leg of the path: pressed, drawn along t1, along t2", ylabel="error of a force, N")
figure
