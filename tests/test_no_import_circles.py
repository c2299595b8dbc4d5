"""No module of the package imports itself by way of others."""

from graphlib import CycleError, TopologicalSorter

import grimp


def test_no_circle_type_checking_imports_and_imports_inside_functions_included():
    graph = grimp.build_graph("structid", cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert len(imports) > 300
    assert sum(map(len, imports.values())) > 1500
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        circle = " imports ".join(reversed(error.args[1]))
        raise AssertionError(circle) from None
