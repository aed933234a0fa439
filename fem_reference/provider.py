"""The shells as a provider of compliance (`mic.compliance.provider`)."""

from __future__ import annotations

from mpi4py import MPI

from fem_reference.shell.compat import versions
from fem_reference.shell.influence import compute_influence
from fem_reference.shell.part import ELEMENTS, ShellPart
from mic.compliance.coefficients import InfluenceCoefficients

__all__ = ["Shells", "shell_part"]


def shell_part(part, comm: MPI.Comm = MPI.COMM_SELF) -> ShellPart:
    """The finite-element body of a part (:class:`mic.compliance.part.Part`) on the processes of `comm`."""
    return ShellPart(part.surface, part.thickness, part.young, part.poisson, part.element, comm)


class Shells:
    """Influence coefficients and displacement fields of sheets, by the shells of `fem_reference.shell`."""

    elements = tuple(ELEMENTS)

    def accepts(self, part) -> bool:
        """Whether the part names one of the elements."""
        return part.element in self.elements

    def coefficients(self, parts, comm=None) -> dict[str, InfluenceCoefficients]:
        """Collective on `comm` (default: this process alone); parts are shared out over it."""
        comm = comm or MPI.COMM_SELF
        bodies = {part.name: _Weighed(part) for part in parts}
        computed = compute_influence(
            {name: lambda body=body: body for name, body in bodies.items()},
            {part.name: part.functionals for part in parts},
            comm,
        )
        found = {}
        for part in parts:
            memory = max(comm.allgather(bodies[part.name].memory))  # it was factorised on one of them
            provenance = {
                "element": part.element,
                "nodes": len(part.surface.points),
                "triangles": len(part.surface.triangles),
                "memory": memory,
                "versions": versions(),
            }
            found[part.name] = InfluenceCoefficients(part.name, *computed[part.name], provenance)
        return found

    def field(self, part, forces):
        """Fields at the vertices on this process alone."""
        shell = shell_part(part)
        return shell.field(part.functionals, forces), shell.rigid_field()


class _Weighed:
    """A part's body, made where it is needed and let go with its factors; what remains is the memory they took, MB."""

    def __init__(self, part):
        self._part, self.memory = part, 0.0

    def influence(self, functionals):
        shell = shell_part(self._part)
        found = shell.influence(functionals)
        self.memory = shell.memory
        return found
