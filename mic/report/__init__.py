"""The offline page of a run and its pictures. Drawing never solves, and changes nothing that a run left."""
