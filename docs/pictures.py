"""What the gallery shows of a script: each new Matplotlib figure among its names, and each new PNG file."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


def pictures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Saves what the last block has made, and gives the text that shows it.

    A picture is a value of the script's names: a figure, or the path of a PNG file that a command wrote.
    """
    kept = block_vars["example_globals"]
    shown: set[int] = kept.setdefault("__shown__", set())
    names = []
    for name, value in list(kept.items()):
        if name.startswith("_") or id(value) in shown:
            continue
        is_file = isinstance(value, Path) and value.suffix == ".png"
        if not (is_file or isinstance(value, Figure)):
            continue
        shown.add(id(value))
        place = Path(next(block_vars["image_path_iterator"]))
        if isinstance(value, Figure):
            value.savefig(place, dpi=130)
        else:
            shutil.copy(value, place)
        names.append(str(place))
    return "".join(figure_rst([name], gallery_conf["src_dir"]) for name in names)
