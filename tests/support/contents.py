"""Whether two nested contents are equal to the last bit."""

from dataclasses import fields, is_dataclass

import numpy as np
import pandas as pd
from scipy.sparse import csr_matrix

__all__ = ["same"]


def same(a: object, b: object) -> bool:
    """Whether two contents are of the same classes, kinds and bits."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and (a.dtype.hasobject or a.tobytes() == b.tobytes())
    if isinstance(a, csr_matrix):
        return same([a.shape, a.data, a.indices, a.indptr], [b.shape, b.data, b.indices, b.indptr])
    if isinstance(a, pd.DataFrame):
        return bool(a.equals(b)) and list(a) == list(b)
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[name], b[name]) for name in a)
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    if is_dataclass(a):
        return all(same(getattr(a, field.name), getattr(b, field.name)) for field in fields(a))
    return bool(a == b)
