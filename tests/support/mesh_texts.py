"""One sheet of three elements, in the text of every format that a reader is written for."""

import numpy as np

__all__ = ["ABAQUS", "FILES", "NASTRAN_FREE", "OBJ", "OFF", "PLY", "POINTS", "VTK"]

# One square of two sheets' elements: a quadrilateral from x = 0 to 1 and a triangle beside it; areas 1 and 0.5.
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0.0]])
NASTRAN_SMALL = """SOL 101
CEND
TITLE = A DECK
BEGIN BULK
$ a comment
PSHELL         1       1     1.0       1               1
GRID           1              0.      0.      0.
GRID           2              1.      0.      0.       1
GRID           3       0      1.      1.
GRID           4             0.0    .1+1       0
GRID          10             2.0   0.0-3      0.
CQUAD4         1       1       1       2       3       4      0.      0.
+             1.      1.      1.      1.
CTRIA3         2       1       2      10       3     45.
CBUSH          7       1       1       2
ENDDATA
GRID          99             bad
"""
NASTRAN_LARGE = """GRID*                  1                              0.              0.
*                     0.
GRID*                  2                 1.0000000000D+0              0.
*
GRID*                  3                              1.              1.
*                     0.
GRID*                  4                              0.              1.
*                     0.
GRID*                 10                              2.              0.
*                     0.
CQUAD4*                1               1               1               2
*                      3               4
CTRIAR         2       1       2      10       3
"""
NASTRAN_FREE = """BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
GRID,4,,0.,1.,0.
GRID,10,,2.,0.,0.
CQUAD8,1,1,1,2,3,4,,,
,,
CTRIA3,2,1,2,10,3
"""
ABAQUS = """*Heading
** a comment
*Part, name=P
*Node
 1, 0., 0., 0.
 2, 1., 0., 0.
 3, 1., 1., 0.
 4, 0., 1., 0.
 10, 2., 0., 0.
*Element, type=S4R, elset=E
1, 1, 2, 3, 4
*Element, type=S3
2, 2, 10, 3
*Elset, elset=all, generate
1, 2, 1
*End Part
"""
OBJ = """mtllib a.mtl
o sheet
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 2 0 0
vt 0 0
vn 0 0 1
f 1/1/1 2/1/1 3/1/1 4/1/1
f 2//1 5//1 3//1
"""
PLY = """ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
2 0 0
4 0 1 2 3
3 1 4 2
"""
VTK = """# vtk DataFile Version 3.0
a sheet
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 5 double
0 0 0 1 0 0 1 1 0 0 1 0 2 0 0
CELLS 2 9
4 0 1 2 3
3 1 4 2
CELL_TYPES 2
9
5
"""
MEDIT = """MeshVersionFormatted 2
Dimension 3
Vertices
5
0 0 0 0
1 0 0 0
1 1 0 0
0 1 0 0
2 0 0 0
Triangles
1
2 5 3 0
Quadrilaterals
1
1 2 3 4 0
End
"""
OFF = "OFF\n5 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 0 0\n3 0 1 2\n3 0 2 3\n3 1 4 2\n"
SU2 = """NDIME= 3
NELEM= 2
9 0 1 2 3 0
5 1 4 2 1
NPOIN= 5
0 0 0 0
1 0 0 1
1 1 0 2
0 1 0 3
2 0 0 4
NMARK= 0
"""
FACET = " facet normal 0 0 1\n  outer loop\n   vertex {}\n   vertex {}\n   vertex {}\n  endloop\n endfacet\n"
STL = (
    "solid a\n"
    + FACET.format("0 0 0", "1 0 0", "1 1 0")
    + FACET.format("0 0 0", "1 1 0", "0 1 0")
    + FACET.format("1 0 0", "2 0 0", "1 1 0")
    + "endsolid a\n"
)
DYNA = """*KEYWORD
*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
4, 0., 1., 0.
10, 2., 0., 0.
*ELEMENT_SHELL
1, 1, 1, 2, 3, 4
2, 1, 2, 10, 3, 3
*END
"""
UNIVERSAL = (
    "    -1\n  2411\n"
    + "".join(f"{n} 1 1 11\n {x} {y} 0.0D+00\n" for n, x, y in ((1, 0, 0), (2, 1, 0), (3, 1, 1), (4, 0, 1), (10, 2, 0)))
    + "    -1\n    -1\n  2412\n1 94 1 1 7 4\n1 2 3 4\n2 91 1 1 7 3\n2 10 3\n    -1\n"
)
FILES = {
    "small.dat": NASTRAN_SMALL,
    "part.k": DYNA,
    "part.key": DYNA,
    "part.dyn": DYNA,
    "part.unv": UNIVERSAL,
    "small.bdf": NASTRAN_SMALL,
    "large.nas": NASTRAN_LARGE,
    "free.fem": NASTRAN_FREE,
    "part.inp": ABAQUS,
    "sheet.obj": OBJ,
    "sheet.ply": PLY,
    "sheet.vtk": VTK,
    "sheet.mesh": MEDIT,
    "SHEET.STL": STL,
    "sheet.off": OFF,
    "sheet.su2": SU2,
}
