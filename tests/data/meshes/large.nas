GRID*                  1                              0.              0.
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
