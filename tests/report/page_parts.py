"""A page read back: what stands before its scripts, the library, and the figures with their arrays in place."""

from __future__ import annotations

import base64
import json
import re
import zlib
from typing import Any

import numpy as np

_PACKED = re.compile(r'<script id="([\w-]+)"(?: class="library")? type="text/plain">([^<]*)</script>')


def words(page: str) -> str:
    """The page up to its first script."""
    return page.split("<script")[0]


def unpacked(page: str) -> dict[str, str]:
    """What the page keeps compressed: ``library-plane`` or ``library-space``, and ``figures``."""
    return {name: zlib.decompress(base64.b64decode(text)).decode("utf-8") for name, text in _PACKED.findall(page)}


def figures(page: str) -> dict[str, list[dict[str, Any]]]:
    """Panels of every figure as the script of the page reads them."""
    return read_figures(unpacked(page)["figures"])


def read_figures(text: str) -> dict[str, list[dict[str, Any]]]:
    """Panels of every figure, each reference to an array replaced by the array."""
    content = json.loads(text)
    arrays = content["arrays"]

    def filled(trace: dict[str, Any]) -> dict[str, Any]:
        places = trace.pop("arrays", {})
        found = {
            key: [arrays[k] for k in place] if isinstance(place, list) else arrays[place]
            for key, place in places.items()
        }
        return trace | found

    return {
        name: [panel | {"data": [filled(trace) for trace in panel["data"]]} for panel in panels]
        for name, panels in content["figures"].items()
    }


def pieces(x: Any, y: Any) -> list[np.ndarray]:
    """Lines or outlines, (n, 2) each, between what is not a number."""
    points = np.column_stack([as_array(x), as_array(y)])
    parts = np.split(points, np.flatnonzero(np.isnan(points[:, 0])))
    parts = [part[~np.isnan(part[:, 0])] for part in parts]
    return [part for part in parts if len(part)]


def as_array(values: Any) -> np.ndarray:
    """Numbers of JSON, NaN for null."""
    return np.array(values, dtype=float)
