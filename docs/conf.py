"""How the documentation site is built: `make docs`."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from sphinx.application import Sphinx
from typer.testing import CliRunner

import structid
from structid.cli.app import COMMANDS, app
from structid.study.json_schema import study_schema

sys.path.insert(0, str(Path(__file__).parent))  # pictures.py and truths.py, for the gallery

#: Parts of the gallery, in their order.
GALLERY = ("commands", "records", "elements", "use", "trust", "benchmarks")

project, author, version = "structid", "the structid authors", structid.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
]
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 4
exclude_patterns = ["_build", "gallery/**/*.py", "gallery/**/*.zip"]
html_theme = "pydata_sphinx_theme"
html_title = f"structid {version}"
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "search_bar_text": "Search: coherence, support, CSV, MAC ...",
}
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
sphinx_gallery_conf = {
    "examples_dirs": ["../examples/gallery"],
    "gallery_dirs": ["gallery"],
    "subsection_order": [f"../examples/gallery/{part}" for part in GALLERY],
    "filename_pattern": r"\.py$",
    "image_scrapers": ["pictures.pictures", "truths.keep_names"],
    "reset_modules": ("truths.check_truths",),
    "reset_modules_order": "both",
    "capture_repr": ("_repr_html_",),
    "matplotlib_animations": False,
    "notebook_extensions": (),
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 10,
    "backreferences_dir": None,
    "remove_config_comments": True,
    "plot_gallery": "True",
    "parallel": 2,
    "abort_on_example_error": True,
}
autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
nitpicky = False

HERE = Path(__file__).parent


def write_commands(place: Path) -> None:
    """A page with the help of every command."""
    text = ["# Commands\n", "Each with `--help`; exit codes are at the end of `structid --help`.\n"]
    for words in ([], *([name] for name in COMMANDS)):
        shown = CliRunner().invoke(app, [*words, "--help"], prog_name="structid", catch_exceptions=False).stdout
        text.append(f"## structid {' '.join(words)}\n\n```text\n{shown.strip()}\n```\n")
    place.write_text("\n".join(text), encoding="utf-8")


def write_keys(place: Path) -> None:
    """A page with every key of a study file, from its declarations."""
    schema = study_schema()
    text = [
        "# Keys of a study file\n",
        "Made from the declarations that read it; `structid schema` gives the same to editors.\n",
    ]
    tables = {f"[{name}]": part for name, part in schema["properties"].items()}
    for name, part in [*tables.items(), *((f"{name}", part) for name, part in schema["$defs"].items())]:
        properties = part.get("properties") or part.get("items", {}).get("properties")
        if not properties:
            continue
        text.append(f"## {name.strip('[]')}\n\n| key | what it is |\n|---|---|")
        text += [f"| `{key}` | {_told(one)} |" for key, one in properties.items()]
        text.append("")
    place.write_text("\n".join(text), encoding="utf-8")


def _told(one: dict[str, object]) -> str:
    told = str(one.get("description", "")).replace("|", "\\|").replace("\n", " ")
    limits = [f"{word} {one[key]}" for key, word in _LIMITS.items() if key in one]
    choices = [", ".join(f"`{c}`" for c in one["enum"])] if isinstance(one.get("enum"), list) else []  # type: ignore[attr-defined]
    default = [f"default {json.dumps(one['default'])}"] if "default" in one else []
    rest = "; ".join([*choices, *limits, *default])
    return f"{told} ({rest})" if told and rest else told or rest


_LIMITS = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}

(HERE / "reference").mkdir(exist_ok=True)
write_commands(HERE / "reference" / "commands.md")
write_keys(HERE / "reference" / "study-keys.md")


def setup(site: Sphinx) -> None:
    """Names of files outside this folder are said where a reader of the source has links to them."""
    site.connect("source-read", _outside)
    site.connect("autodoc-process-docstring", _magnitudes, priority=400)


def _outside(site: Sphinx, name: str, source: list[str]) -> None:
    source[0] = re.sub(r"\[([^\]]+)\]\(\.\./([^)]+)\)", r"\1 (`\2` in the source)", source[0])


def _magnitudes(site: Sphinx, what: str, name: str, given: object, options: object, lines: list[str]) -> None:
    """Bars of magnitudes, as in |H|, are no substitutions."""
    lines[:] = [
        "``".join(part if i % 2 else part.replace("|", "\\|") for i, part in enumerate(line.split("``")))
        for line in lines
    ]
