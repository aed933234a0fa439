"""
Full frictional contact with FEniCSx
====================================

The finite elements that judge the reduced model also solve problems that no scene describes. A program states sheets on
dolfinx meshes, supports, loads and contacts, and gets dolfinx Functions. Here two leaves of a spring are pressed
together and bent to and fro: friction holds them like one beam, until they slip. Goodman and Klumpp (1956) give
deflection and damping in closed form. `mpirun -n 2 python -m mpi4py full_contact.py` distributes the sparse system.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import ufl
from mpi4py import MPI
from dolfinx import fem

from fem_reference.contact_problem import Contact, ContactProblem, Force, Sheet, Support, Traction, Writer
from fem_reference.shell.compat import compile_form, shell_mesh
from mic.geometry.structured import extrude

LENGTH, WIDTH, THICKNESS = 100.0, 5.0, 2.0  # mm
YOUNG, PRESSURE, FRICTION = 210e3, 1.0, 0.3  # MPa, MPa, 1

# %%
# Two sheets on any dolfinx meshes of linear triangles, such as from Gmsh. Here `shell_mesh` makes them from arrays with
# every supported dolfinx.
leaves = []
for name, height in (("lower", 0.0), ("upper", THICKNESS)):
    points, triangles, _ = extrude([(0.0, height), (WIDTH, height)], 0.0, LENGTH, 5.0)
    mesh = shell_mesh(MPI.COMM_WORLD, points, triangles)
    leaves.append(Sheet(mesh, THICKNESS, YOUNG, poisson=0.0, name=name))
lower, upper = leaves


# %%
# Places are markers of positions, as in dolfinx, or mesh tags with a value. A component None of a support is free.
def at_root(x):
    return np.isclose(x[0], 0)


def at_tip(x):
    return np.isclose(x[0], LENGTH)


supports = [Support(leaf, at_root, displacement=(0, 0, 0), rotation=(0, 0, 0)) for leaf in leaves]
presses = [Traction(leaf, lambda x: x[0] > -1, (0, 0, sign * PRESSURE)) for leaf, sign in zip(leaves, (1, -1))]
tips = [Force(leaf, at_tip, (0, 0, 0)) for leaf in leaves]
faying = Contact(lower, upper, FRICTION, where=lambda x: x[0] > 0.1)
problem = ContactProblem(supports, [*presses, *tips], [faying])

# %%
# Loads may change between solves. Each solve continues from the last one, so friction remembers: first the press, then
# one load upwards and a full cycle. The files of `Writer` open in ParaView.
slip_load = 4 / 3 * FRICTION * PRESSURE * WIDTH * THICKNESS
largest = 2 * slip_load
ways = [np.linspace(a, b, 9)[1:] * largest for a, b in ((0, 1), (1, -1), (-1, 1))]
loads, solutions = [0.0], [problem.solve()]
for load in np.concatenate(ways):
    for tip in tips:
        tip.value = (0, 0, load / 2)
    loads.append(load)
    solutions.append(problem.solve())
folder = Path(tempfile.mkdtemp())
with Writer(problem, folder) as files:
    for time, solution in enumerate(solutions):
        files.write(solution, time)
print(sorted(path.name for path in folder.iterdir()))

# %%
# A solution has Functions on the meshes, so UFL works on them: the mean deflection of the outer half of the leaf.
x = ufl.SpatialCoordinate(upper.mesh)
outer = ufl.conditional(ufl.gt(x[0], LENGTH / 2), 1.0, 0.0)


def integral(form):
    return upper.mesh.comm.allreduce(fem.assemble_scalar(compile_form(form)))


area = integral(outer * ufl.dx(domain=upper.mesh))
mean = [integral(outer * solution.displacement(upper)[2] * ufl.dx) / area for solution in solutions]

# %%
# Above the slip load the leaves bend alone, with four times the deflection per load. The loop's area is the energy that
# friction takes; `dissipated` is its sum over the contacts.
compliance = LENGTH**3 / (YOUNG * WIDTH * THICKNESS**3)
exact = 6 * slip_load * (largest - slip_load) * compliance
found = sum(solution.dissipated for solution in solutions[-16:])
print(f"work of friction in a cycle: {found:.4f} N mm, closed form {exact:.4f} N mm; route: {solutions[-1].route}")

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.plot(mean, loads, "o-", ms=3)
left.set(xlabel="mean deflection of the outer half (mm)", ylabel="load at the tip (N)")
held = [
    np.linalg.norm(contact.force[:, 1:], axis=1).sum() / (FRICTION * contact.force[:, 0].sum())
    for solution in solutions
    for contact in solution.contacts
]
right.plot(mean, held, "o-", ms=3)
right.set(xlabel="mean deflection of the outer half (mm)", ylabel="friction force / friction bound")
plt.show()
