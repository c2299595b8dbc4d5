"""The numbers of a section of a Gmsh file, one after another, from text or from bytes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from structid.core.arrays import FloatArray, IntArray

#: Cells of one type: the type, the physical group and the entity of each (0 where it has none), and their nodes.
Cells = tuple[int, IntArray, IntArray]
#: A physical group: its dimension (not in version 2.0), its number and its name.
_GROUP = re.compile(rb'\s*(?:(\d+)[ \t]+)?(\d+)[ \t]+"([^"]*)"[^\r\n]*')


class Numbers(Protocol):
    """Reader of numbers from a Gmsh file, the part that text and binary files share.

    `integers` are whole numbers of 4 bytes, `sizes` those of 8, `counts` stand in text even in binary files.
    """

    offset: int

    def integers(self, count: int) -> IntArray: ...

    def sizes(self, count: int) -> IntArray: ...

    def counts(self, count: int) -> IntArray: ...

    def reals(self, count: int) -> FloatArray: ...

    def integer(self) -> int: ...

    def groups(self) -> list[tuple[int | None, int, str]]:
        """Dimension, number and name of each physical group; None where the file does not say its dimension."""
        ...

    def old_nodes(self, count: int) -> tuple[IntArray, FloatArray]:
        """Numbers and positions of the nodes of version 2."""
        ...

    def old_elements(self, count: int, width: Callable[[int], int]) -> Iterator[Cells]:
        """The elements of version 2, neighbours of one type together; `width` is the number of nodes of a type."""
        ...


class Ascii:
    """Numbers in the text from `offset` to `stop`."""

    def __init__(self, data: bytes, offset: int, stop: int) -> None:
        """Numbers in the text `data` from byte `offset` to byte `stop`."""
        self.offset, self.stop = offset, stop
        self._text = data[offset:stop]
        self._words: np.ndarray | None = None
        self._at = 0

    def _next(self, count: int) -> np.ndarray:
        """The next `count` words, an array (count,) of texts; `ValueError` if the section has fewer."""
        if self._words is None:
            self._words = np.array(self._text.split())
        part = self._words[self._at : self._at + count]
        if count < 0 or len(part) != count:
            raise ValueError("a section ends too soon")
        self._at += count
        if self._at == len(self._words):
            self.offset = self.stop
        return part

    def integers(self, count: int) -> IntArray:
        return self._next(count).astype(np.int64) if count else np.zeros(0, np.int64)

    sizes = counts = integers

    def reals(self, count: int) -> FloatArray:
        return self._next(count).astype(np.float64)

    def integer(self) -> int:
        """The next whole number."""
        return int(self._next(1)[0])

    def groups(self) -> list[tuple[int | None, int, str]]:
        """Dimension, number and name of each physical group; the dimension is None if the file does not say it.

        Raises `ValueError` if a group cannot be read.
        """
        head = re.match(rb"\s*(\d+)", self._text)
        if head is None:
            raise ValueError("the names of physical groups begin with no count")
        offset = head.end()
        groups: list[tuple[int | None, int, str]] = []
        for _ in range(int(head[1])):
            match = _GROUP.match(self._text, offset)
            if match is None:
                raise ValueError("a physical group has no number, or no name in quotation marks")
            offset = match.end()
            groups.append((int(match[1]) if match[1] else None, int(match[2]), match[3].decode("utf-8", "replace")))
        self.offset += offset
        return groups

    def old_nodes(self, count: int) -> tuple[IntArray, FloatArray]:
        table = self._next(4 * count).reshape(count, 4)
        return table[:, 0].astype(np.int64), table[:, 1:].astype(np.float64)

    def old_elements(self, count: int, width: Callable[[int], int]) -> Iterator[Cells]:
        """Runs of neighbouring elements of one type in a section of version 2: type, tags (n, 2) and nodes (n, n_nodes).

        Tags are the physical group and the entity, 0 where absent. `count` is the number of elements; `width` returns the
        number of nodes of a type.
        """
        assert self._words is not None
        numbers = self._words[self._at :].astype(np.int64)
        begin, elements = 0, []
        for _ in range(count):
            kind, n_tags = int(numbers[begin + 1]), int(numbers[begin + 2])
            stop = begin + 3 + n_tags + width(kind)
            if stop > len(numbers):
                raise ValueError("a section ends too soon")
            tags = [*numbers[begin + 3 : begin + 3 + min(n_tags, 2)].tolist(), 0, 0][:2]
            elements.append((kind, tags, begin + 3 + n_tags, stop))
            begin = stop
        if begin == len(numbers):
            self.offset = self.stop
        first = 0
        for last in range(1, len(elements) + 1):
            if last == len(elements) or elements[last][0] != elements[first][0]:
                run = elements[first:last]
                rows = np.stack([numbers[a:b] for _, _, a, b in run])
                yield run[0][0], np.array([tags for _, tags, _, _ in run]), rows
                first = last


class Binary:
    """Numbers in the bytes from `offset`; `swapped` where they are in the other byte order."""

    def __init__(self, data: bytes, offset: int, swapped: bool) -> None:
        self.offset = offset
        self._data = data
        self._order = ">" if swapped == (sys.byteorder == "little") else "<"

    def _next(self, form: np.dtype, count: int) -> np.ndarray:
        """The next `count` numbers of the type `form`, (count,); `ValueError` if the file has fewer."""
        if count < 0 or self.offset + count * form.itemsize > len(self._data):
            raise ValueError("a section ends too soon")
        part = np.frombuffer(self._data, form, count, self.offset)
        self.offset += count * form.itemsize
        return part

    def integers(self, count: int) -> IntArray:
        return self._next(np.dtype(self._order + "i4"), count).astype(np.int64)

    def sizes(self, count: int) -> IntArray:
        return self._next(np.dtype(self._order + "u8"), count).astype(np.int64)

    def counts(self, count: int) -> IntArray:
        """The next `count` whole numbers, (count,), which stand on a line of text."""
        stop = self._data.index(b"\n", self.offset)
        words = np.array(self._data[self.offset : stop].split()[:count]).astype(np.int64)
        self.offset = stop + 1
        return words

    def reals(self, count: int) -> FloatArray:
        return self._next(np.dtype(self._order + "f8"), count).astype(np.float64)

    def integer(self) -> int:
        return int(self.integers(1)[0])

    def groups(self) -> list[tuple[int | None, int, str]]:
        raise ValueError("names of physical groups stand in text")

    def old_nodes(self, count: int) -> tuple[IntArray, FloatArray]:
        table = self._next(np.dtype([("label", self._order + "i4"), ("at", self._order + "f8", (3,))]), count)
        return table["label"].astype(np.int64), table["at"].astype(np.float64)

    def old_elements(self, count: int, width: Callable[[int], int]) -> Iterator[Cells]:
        """Blocks of elements in a section of version 2: type, tags (n, 2) and nodes (n, n_nodes).

        Tags are the physical group and the entity, 0 where absent. `count` is the number of elements; `width` returns the
        number of nodes of a type.
        """
        done = 0
        while done < count:
            kind, n_elements, n_tags = self.integers(3).tolist()
            if n_elements < 1:
                raise ValueError("a block of elements is empty")
            rows = self.integers(n_elements * (1 + n_tags + width(kind))).reshape(n_elements, -1)
            tags = np.pad(rows[:, 1 : 1 + min(n_tags, 2)], ((0, 0), (0, 2 - min(n_tags, 2))))
            yield kind, tags, rows[:, 1 + n_tags :]
            done += n_elements
