"""Contact pairs: positions where two nominal surfaces face each other, and the patches on which each pair acts.

`find_pairs` samples the first surface finely. A sampling point belongs to the zone if it lies in the zone's region and
its closest point on the other surface faces it: the normals agree within an angle, the joining line runs along the
normal, and the gap between the *facing* surfaces (both half-thicknesses subtracted) is within a limit. The points are
then clustered into cells of about equal size. A pair's patch is its cell, evaluated on one surface and, point by point,
at the projections on the other, so that the two forces of a pair act on one line and cause no couple.

A sheet within a hem or slot faces the other body on both sides. Each side is clustered separately.

A zone that states neither a number of pairs nor points gets *candidates* with the spacing

    max(one element, min(4 t, 1.5 r)),        t the thinner sheet, r the smallest clamp's radius;

in a zone with bends of radius R at most max(0.85 elements, 1.3 √(R t)): the effect of a force on a bent sheet decays
over about √(R t), and sheets pass through each other at a facet that no candidate reads. The zone's `spacing_factor`
scales all these distances, including those under clamps.

Candidates are placed

- along the *edges* and folds of both bodies and the rims of round rests; each reads a length of the edge;
- at *corners* of borders, at ends of folds on a border, and where edges of the two bodies *cross*; each reads one
  point;
- at every point where something presses the sheets together;
- over the remaining area; each reads a cell.

Under a clamp's pad the spacing is 2/3 r, however coarse the elements, because on a single pair the sheets could tilt.
A candidate reads the part of its length or cell with the smallest gap, where contact begins. No cell crosses the rim of
a nugget, of a clamp's pad or of the pad of a rest beneath a clamp. The cells within a pad then carry its uniform
pressure uniformly, and a nominal assembly does not move.

The normal of a pair is that of the curved sheet, interpolated between the normals at the corners of the triangle. The
normals of facets jump across a bend by more than the angle of friction. An edge or fold presses along the normal of the
sheet that it presses on.

`find_between` places check points *between* the pairs, where the penetration that the pairs miss is measured.
`node_pairs` uses the vertices of both meshes instead, as node-to-surface contact does, in both directions.

Rounding must not decide which points belong to a zone or to a pair: points on the border of a region are inside, and
ties between cells are broken by the distances from the scene's locators. A scene that is rotated, mirrored, renumbered
or written in other units therefore has the same pairs, in the same order.
"""

from mic.geometry.pairing.candidates import candidate_spacing
from mic.geometry.pairing.contact_pair import ContactPair, PressedPoint, Side
from mic.geometry.pairing.node_pairs import node_pairs
from mic.geometry.pairing.pair_search import find_between, find_pairs, pair_at
from mic.geometry.pairing.standing_edges import standing_edge

__all__ = [
    "ContactPair",
    "PressedPoint",
    "Side",
    "candidate_spacing",
    "find_between",
    "find_pairs",
    "node_pairs",
    "pair_at",
    "standing_edge",
]
