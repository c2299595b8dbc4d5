"""Node numbers of a Gmsh file, which meshio does not keep."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from structid.arrays import IntArray
from structid.errors import FileError

_REMEDY = "save it as ASCII, version 4.1 or 2.2 (Mesh.Binary = 0, Mesh.MshFileVersion = 4.1)"


def gmsh_labels(path: Path) -> IntArray:
    """Numbers of the nodes in the order of the file.

    Raises
    ------
    FileError
        If the file is binary, of a version without such numbers, or cut short.
    """
    version, opened, labels = "", "", None
    with path.open(encoding="utf-8", errors="replace") as stream:
        for line in stream:
            word = line.strip()
            if not word.startswith("$"):
                continue
            if opened and word != f"$End{opened}":
                break
            opened = "" if opened else word[1:]
            if word == "$MeshFormat":
                version, binary = (*stream.readline().split(), "", "")[:2]
                if binary != "0":
                    raise FileError(f"{path}: is binary, where node numbers cannot be read; {_REMEDY}")
            if word == "$Nodes":
                try:
                    labels = _in_blocks(stream) if version in ("4", "4.1") else _in_lines(stream)
                except (ValueError, IndexError) as error:
                    raise FileError(f"{path}: cannot be read as gmsh ({error}); {_REMEDY}") from error
    if opened or labels is None:
        raise FileError(f"{path}: is cut short: ${opened or 'Nodes'} is not closed; {_REMEDY}")
    if version == "4.0":
        raise FileError(f"{path}: node numbers of version 4.0 cannot be read; {_REMEDY}")
    return np.array(labels, dtype=np.int64)


def _in_lines(stream: TextIO) -> list[int]:
    """Version 2.2: one line a node, its number first."""
    total = int(stream.readline().split()[0])
    return [int(line.split(maxsplit=1)[0]) for line in islice(stream, total)]


def _in_blocks(stream: TextIO) -> list[int]:
    """Version 4.1: blocks of numbers, then of coordinates."""
    blocks = int(stream.readline().split()[0])
    labels: list[int] = []
    for _ in range(blocks):
        own = int(stream.readline().split()[3])
        labels += [int(line) for line in islice(stream, own)]
        for _ in range(own):
            stream.readline()
    return labels
