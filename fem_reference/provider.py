"""The shells as a provider of compliance (`mic.compliance.provider`)."""

from __future__ import annotations

from mpi4py import MPI

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
        computed = compute_influence(
            {part.name: lambda part=part: shell_part(part) for part in parts},
            {part.name: part.functionals for part in parts},
            comm or MPI.COMM_SELF,
        )
        return {part.name: InfluenceCoefficients(part.name, *computed[part.name], _provenance(part)) for part in parts}

    def field(self, part, forces):
        """Fields at the vertices on this process alone."""
        shell = shell_part(part)
        return shell.field(part.functionals, forces), shell.rigid_field()


def _provenance(part):
    return {
        "element": part.element,
        "nodes": len(part.surface.points),
        "triangles": len(part.surface.triangles),
    }
