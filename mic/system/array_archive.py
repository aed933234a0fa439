"""Read the arrays of an uncompressed ``.npz`` file; the file is checked before memory is allocated.

`numpy.load` evaluates the header of each array as Python, allocates what that header claims, unpickles on request and
inflates compressed members. Here a header must have the text that numpy writes, with a numeric or text type; an array
must have the size of its member of the archive; and all members together must fit into the file.
"""

from __future__ import annotations

import math
import os
import re
import zipfile
from typing import BinaryIO

import numpy as np

__all__ = ["read_archive"]

SUFFIX = ".npy"
CHUNK = 1 << 20  # bytes that are copied at a time
_PREAMBLE = b"\x93NUMPY\x01\x00"  # version 1.0 of the format of arrays
_HEADER = re.compile(
    rb"\{'descr': '([<>|][biufcU]\d{1,9})', 'fortran_order': (True|False), 'shape': \((|\d+,|\d+(?:, \d+)+)\), \} *\n"
)


def read_archive(file: BinaryIO) -> dict[str, np.ndarray]:
    """Arrays by name, in the order of the file.

    Raises
    ------
    Exception
        Of any type, if the file is damaged or was not written by :func:`numpy.savez`.
    """
    size = os.fstat(file.fileno()).st_size
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        names = [member.filename for member in members]
        if len(set(names)) != len(names) or not all(name.endswith(SUFFIX) for name in names):
            raise ValueError("the names of members are not those of arrays, or occur twice")
        if any(member.compress_type != zipfile.ZIP_STORED for member in members):
            raise ValueError("a member is compressed")
        if sum(member.file_size for member in members) > size:
            raise ValueError("the members are larger than the file")
        return {member.filename.removesuffix(SUFFIX): _read_member(archive, member) for member in members}


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(member) as content:
        if content.read(len(_PREAMBLE)) != _PREAMBLE:
            raise ValueError(f"{member.filename}: not an array of format 1.0")
        length = int.from_bytes(content.read(2), "little")
        header = _HEADER.fullmatch(content.read(length))
        if header is None:
            raise ValueError(f"{member.filename}: invalid header")
        dtype = np.dtype(header[1].decode())
        shape = tuple(int(number) for number in header[3].split(b",") if number)
        count = math.prod(shape)
        if not dtype.itemsize or count * dtype.itemsize != member.file_size - len(_PREAMBLE) - 2 - length:
            raise ValueError(f"{member.filename}: its size is not that of its array")
        array = np.empty(count, dtype)
        target = array.view(np.uint8)
        for start in range(0, len(target), CHUNK):
            piece = target[start : start + CHUNK]
            piece[:] = np.frombuffer(content.read(len(piece)), np.uint8)
        content.read(1)  # compares the checksum of the member, even if the array is empty
    return array.reshape(shape[::-1]).T if header[2] == b"True" else array.reshape(shape)
