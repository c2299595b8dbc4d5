"""Examples in public docstrings give what they say."""

import doctest
import importlib
import pkgutil

import pytest

import structid

MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(structid.__path__, "structid.")
    if not module.name.startswith(("structid.cli", "structid.__main__"))
)


def _with_examples(name):
    try:
        module = importlib.import_module(name)
    except ImportError:  # an extra that is not installed
        return []
    return [found for found in doctest.DocTestFinder(exclude_empty=True).find(module, name) if found.examples]


EXAMPLES = [found for name in MODULES for found in _with_examples(name)]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda one: one.name)
def test_example_gives_what_it_says(example):
    results = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS).run(example)
    assert results.failed == 0


def test_the_main_verbs_have_examples():
    named = {example.name.rsplit(".", 1)[-1] for example in EXAMPLES}
    assert {"mac", "parse_dof"} <= named
