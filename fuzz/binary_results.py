"""Binary results of Nastran (.op2), written record by record in every form that the format allows."""

import random
import struct
from collections.abc import Sequence
from itertools import pairwise


class Writer:
    """Fortran records of markers and data, in words of four or eight bytes."""

    def __init__(self, order: str = "<", size: int = 4, has_head: bool = True) -> None:
        self.order, self.size = order, size
        self.content = b""
        if has_head:
            self.data(self.words(1, 31, 2026)[: 3 * size])
            self.data(self.text("NASTRAN FORT TAPE ID CODE - "))
            self.data(self.text("XXXXXXXX"))
            self.marker(-1)
            self.marker(0)

    def words(self, *values: int | float | str) -> bytes:
        """Integers, reals and texts of four letters as words."""
        letters = {4: ("i", "f"), 8: ("q", "d")}[self.size]
        made = b""
        for value in values:
            if isinstance(value, str):
                made += value.ljust(4).encode().ljust(self.size)
            else:
                made += struct.pack(self.order + letters[isinstance(value, float)], value)
        return made

    def text(self, text: str) -> bytes:
        return self.words(*(text[k : k + 4] for k in range(0, len(text), 4)))

    def record(self, data: bytes) -> None:
        length = struct.pack(self.order + "i", len(data))
        self.content += length + data + length

    def marker(self, value: int) -> None:
        self.record(self.words(value))

    def data(self, data: bytes, pieces: int = 1) -> None:
        count = len(data) // self.size
        cuts = [0, *sorted(random.Random(1).sample(range(1, count), pieces - 1)), count]
        for start, stop in pairwise(cuts):
            self.marker(stop - start)
            self.record(data[start * self.size : stop * self.size])

    def table(self, name: str, parts: Sequence[bytes], pieces: int = 1) -> None:
        self.data(self.text(name.ljust(8)))
        self.marker(-1)
        self.data(self.words(101, 0, 0, 0, 0, 0, 0))
        self.marker(-2)
        self.data(self.words(0))
        self.data(self.text(name.ljust(8)))
        for number, part in enumerate(parts, 3):
            self.marker(-number)
            self.data(self.words(0))
            self.data(part, pieces)
        self.marker(-len(parts) - 3)
        self.data(self.words(0))
        self.marker(0)

    def matrix(self) -> None:
        """A table whose records have a word more than their marker says, as columns of matrices do."""
        self.data(self.text("MATPOOL "))
        self.marker(-1)
        self.data(self.words(102, 3, 3, 6, 1, 2, 3))
        self.marker(-2)
        self.data(self.words(0))
        self.data(self.text("MATPOOL "))
        self.marker(-3)
        self.data(self.words(1))
        self.marker(2)
        self.record(self.words(1, 1.0, 2.0))
        self.marker(-4)
        self.marker(0)

    def heading(
        self, approach: int, kind: int, subcase: int, mode: int, first: float, second: float, form: int, width: int
    ) -> bytes:
        words = [10 * approach + 1, kind, 0, subcase, mode, first, second, 0, form, width]
        return self.words(*words) + self.words(*[0] * 40) + self.text(" " * 4 * 96)

    def vector(
        self,
        points: Sequence[int],
        values: Sequence[Sequence[float]],
        scalars: Sequence[int] = (),
        is_complex: bool = False,
    ) -> bytes:
        """Lines of points; `values` (n_points, 6 or 12)."""
        lines = b""
        for point, row in zip(points, values, strict=True):
            lines += self.words(10 * point + 1, 1, *map(float, row))
        for point in scalars:
            lines += self.words(10 * point + 1, 2, *[0.5] * (12 if is_complex else 6))
        return lines

    def end(self) -> bytes:
        self.marker(0)
        return self.content
