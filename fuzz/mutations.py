"""Ways to damage a file: bytes, numbers at their extremes, ends cut off, parts doubled or lost, sizes that are not so."""

from __future__ import annotations

import io
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable

TEXTS = (
    "0", "-1", "1", "2", "-0.0", "nan", "inf", "-inf", "1e400", "1e308", "1e-320", "5e-324", "1.5D+03", "1.5+3", "4,5", "1_0",
    "0x10", "999999999", "2147483648", "-2147483649", "9223372036854775808", "99999999999999999999999", "1" * 5000, "",
    "\0", "\x1b[31m", "é", "x", "-", ".", "1 2", '"', "'", "[", "1e", "\t", "٣",
)  # fmt: skip
STUDY_VALUES = (
    "0", "-1", "1e-320", "1e100", "1e308", "nan", "inf", "-inf", "true", '""', '"x"', '"\\u0000"', '"\\u001b[31m"', "[]", "[[]]",
    "[1]", "[1, 2]", "[1.0, 1.0]", '["1X"]', '["1X", "1X"]', "{}", "{ a = 1 }", "1979-05-27", "9223372036854775807",
    "99999999999999999999999", "-99999999999999999999999", "[1e-320, 1e308]", '"../"', '"/dev/zero"', '"1X,"', "[0]", "[-1]",
    "1" * 5000, "[" * 20000, '"all"', '"9999999999999999999X"',
)  # fmt: skip
_NUMBER = re.compile(rb"[+-]?\d+\.?\d*(?:[eEdD][+-]?\d+)?")
_EXTREMES = (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1)
_EXTREMES_8 = (*_EXTREMES, 2**63 - 1, 2**63, 2**64 - 1, 2**40)

Mutation = Callable[[random.Random, bytes], bytes]


def few_bytes(rng: random.Random, data: bytes) -> bytes:
    """One to three bytes changed."""
    found = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        found[rng.randrange(len(found))] = rng.randrange(256)
    return bytes(found)


def early_bytes(rng: random.Random, data: bytes) -> bytes:
    """One to three bytes of the first 512 changed, where headers are."""
    head = data[:512]
    return few_bytes(rng, head) + data[512:]


def cut(rng: random.Random, data: bytes) -> bytes:
    """The end cut off."""
    return data[: rng.randrange(len(data))]


def doubled(rng: random.Random, data: bytes) -> bytes:
    """A part repeated somewhere."""
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[a:b] + data[at:]


def lost(rng: random.Random, data: bytes) -> bytes:
    """A part left out."""
    a = rng.randrange(len(data))
    return data[:a] + data[a + rng.randint(1, 64) :]


def extreme_integer(rng: random.Random, data: bytes) -> bytes:
    """Four or eight bytes made an integer at an end of its range: sizes, offsets, counts."""
    size = rng.choice((1, 2, 4, 8))
    if len(data) < size:
        return few_bytes(rng, data)
    value = rng.choice(_EXTREMES_8) % 2 ** (8 * size)
    at = rng.randrange(min(len(data), 2048) - size + 1) if rng.random() < 0.7 else rng.randrange(len(data) - size + 1)
    return data[:at] + value.to_bytes(size, rng.choice(("little", "big"))) + data[at + size :]


def extreme_real(rng: random.Random, data: bytes) -> bytes:
    """Eight bytes made a real number that is none, or at the end of its range."""
    if len(data) < 8:
        return few_bytes(rng, data)
    at = rng.randrange(len(data) - 7)
    value = rng.choice((float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0))
    return data[:at] + struct.pack(rng.choice(("<d", ">d")), value) + data[at + 8 :]


def extreme_text(rng: random.Random, data: bytes) -> bytes:
    """A number in a text replaced by another, or by what is none."""
    places = list(_NUMBER.finditer(data))
    if not places:
        return few_bytes(rng, data)
    place = rng.choice(places)
    return data[: place.start()] + rng.choice(TEXTS).encode() + data[place.end() :]


def lines_changed(rng: random.Random, data: bytes) -> bytes:
    """A line lost, doubled, emptied or moved."""
    lines = data.split(b"\n")
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    how = rng.randrange(4)
    if how == 0:
        del lines[at]
    elif how == 1:
        lines.insert(other, lines[at])
    elif how == 2:
        lines[at] = b""
    else:
        lines[at], lines[other] = lines[other], lines[at]
    return b"\n".join(lines)


def study_value(rng: random.Random, data: bytes) -> bytes:
    """The value of a key of a study replaced by a wrong one."""
    places = list(re.finditer(rb"=[ ]*([^\n]+)", data))
    if not places:
        return few_bytes(rng, data)
    place = rng.choice(places)
    return data[: place.start(1)] + rng.choice(STUDY_VALUES).encode() + data[place.end(1) :]


def in_archive(inner: Mutation) -> Mutation:
    """`inner` on a member of an NPZ archive, whose checksums are made to fit again."""

    def mutated(rng: random.Random, data: bytes) -> bytes:
        written = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(written, "w") as target:
            names = source.namelist()
            chosen = rng.choice(names)
            for name in names:
                content = source.read(name)
                target.writestr(name, inner(rng, content) if name == chosen else content)
        return written.getvalue()

    return mutated


def in_compressed_variable(inner: Mutation) -> Mutation:
    """`inner` on a compressed variable of a MAT file of version 5, packed again."""

    def mutated(rng: random.Random, data: bytes) -> bytes:
        at, parts = 128, []
        while at + 8 <= len(data):
            kind, size = struct.unpack_from("<II", data, at)
            parts.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
        chosen = rng.randrange(len(parts))
        found = [data[:128]]
        for i, (kind, part) in enumerate(parts):
            if i == chosen and kind == 15:
                part = zlib.compress(inner(rng, zlib.decompress(part)))
            found.append(struct.pack("<II", kind, len(part)) + part)
        return b"".join(found)

    return mutated


BINARY: tuple[Mutation, ...] = (
    few_bytes, few_bytes, early_bytes, cut, doubled, lost, extreme_integer, extreme_integer, extreme_real,
)  # fmt: skip
TEXT: tuple[Mutation, ...] = (
    few_bytes, early_bytes, cut, doubled, lost, extreme_text, extreme_text, extreme_text, lines_changed, lines_changed,
)  # fmt: skip
ARCHIVE: tuple[Mutation, ...] = (
    *BINARY,
    *(in_archive(inner) for inner in (*BINARY, *BINARY, extreme_text, extreme_text)),
)
COMPRESSED: tuple[Mutation, ...] = (*BINARY, *(in_compressed_variable(inner) for inner in (*BINARY, *BINARY)))
STUDY: tuple[Mutation, ...] = (*TEXT, *(study_value,) * 10)
