"""The templates of the HTML pages, all read the same way."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


@cache
def page_template(name: str) -> Any:
    """The template in the file `name`; a value that it needs and is not given is an error."""
    environment = Environment(
        loader=PackageLoader("structid.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    return environment.get_template(name)
