"""Public names load on first use, and what is loaded when: nothing is timed."""

from __future__ import annotations

import importlib
import os
import pkgutil
import subprocess
import sys
from importlib.util import find_spec

import pytest

from structid.cli.app import COMMANDS
from study_cases import write_chain

PACKAGES = ("structid", "structid.records", "structid.modal")
#: Packages inside, whose names load on first use too.
INNER = (
    "structid.diagnose",
    "structid.dynamics",
    "structid.external",
    "structid.fem",
    "structid.fem.elements",
    "structid.forward",
    "structid.modal.formats",
    "structid.identification.setups",
    "structid.inversion",
    "structid.study.schema.model",
    "structid.study.schema.records",
)
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


def modules_after(statement: str, **options) -> set[str]:
    code = f"import sys; before = set(sys.modules); {statement}; print('loaded', *(set(sys.modules) - before))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT, check=True, **options
    )
    return set(done.stdout.split("loaded ")[-1].split())


def called(*words: str) -> str:
    return (
        f"from typer.testing import CliRunner; from structid.cli.app import app; CliRunner().invoke(app, {list(words)})"
    )


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there(package):
    module = importlib.import_module(package)
    assert len(module.__all__) > 10
    assert dir(module) == module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        module.nothing  # noqa: B018


@pytest.mark.parametrize("package", [*PACKAGES, *INNER])
def test_no_module_hides_a_public_name(package):
    """`import structid.plan` would put a module in the place of the function `plan`."""
    module = importlib.import_module(package)
    inner = {found.name for found in pkgutil.iter_modules(module.__path__)}
    assert not inner & set(module.__all__)
    assert all(getattr(module, name) is not None for name in module.__all__)


def test_import_structid_waits_for_nothing():
    loaded = modules_after("import structid")
    assert {name.split(".")[0] for name in loaded} <= {"structid", *sys.stdlib_module_names}
    assert {name for name in loaded if name.startswith("structid")} <= {
        "structid",
        "structid._version",
        "structid.lazy",
    }


def test_a_name_loads_what_it_needs_only():
    loaded = modules_after("from structid import FrfRecord, Structure, read_record")
    assert "numpy" in loaded
    assert {"scipy.optimize", "scipy.signal", "h5py", "matplotlib", "plotly", "typer", "rich"}.isdisjoint(loaded)
    assert {"structid.forward", "structid.identification", "structid.modal"}.isdisjoint(loaded)


def test_the_help_needs_no_command():
    loaded = modules_after(called("--help"))
    assert "typer" in loaded
    assert {"numpy", "scipy", "rich.table"}.isdisjoint(loaded)
    assert {name for name in loaded if name.startswith("structid.")} == {
        "structid._version", "structid.lazy", "structid.core", "structid.core.errors", "structid.cli", "structid.cli.app",
        "structid.cli.base", "structid.cli.commands",
    }  # fmt: skip


#: Commands whose flags are options of records, of files of modes or of meshes; the others need no array for their help.
WITH_ARRAYS = {"modes", "convert", "init", "sense"}
DRAWING = {"matplotlib", "plotly", "jinja2", "rich", "h5py", "scipy.optimize", "scipy.signal"}


def test_the_help_of_a_command_needs_nothing_of_its_work():
    """All helps in one process: 0.2 s of processor each, where the work's own modules take 2 s."""
    words = [[name, "--help"] for name in COMMANDS if name not in WITH_ARRAYS]
    loaded = modules_after(
        "from typer.testing import CliRunner; from structid.cli.app import app; "
        f"assert not any(CliRunner().invoke(app, w).exit_code for w in {words})"
    )
    assert (DRAWING | {"numpy", "scipy"}).isdisjoint(loaded)
    parts = {name for name in loaded if name.startswith("structid.") and not name.startswith("structid.cli.commands.")}
    assert parts <= {
        "structid._version", "structid.lazy", "structid.core", "structid.core.constraints", "structid.core.errors",
        "structid.cli", "structid.cli.app", "structid.cli.base", "structid.cli.commands",
        "structid.compare", "structid.compare.options", "structid.prediction", "structid.prediction.options",
    }  # fmt: skip


@pytest.mark.parametrize("name", sorted(WITH_ARRAYS))
def test_the_help_of_a_command_with_options_of_files_needs_no_drawing_and_no_study(name):
    loaded = modules_after(called(name, "--help"))
    assert DRAWING.isdisjoint(loaded)
    packages = {".".join(module.split(".")[:2]) for module in loaded if module.startswith("structid.")}
    assert {"structid.report", "structid.forward", "structid.identification", "structid.inversion"}.isdisjoint(packages)


def test_check_and_identify_draw_nothing_and_open_no_format_but_their_own(tmp_path):
    study = str(write_chain(tmp_path))
    loaded = modules_after(called("check", study), cwd=tmp_path)
    drawing = {"matplotlib", "plotly", "jinja2", "structid.report"}
    assert "structid.study.run.check" in loaded
    assert (drawing | {"h5py", "pyuff", "scipy.signal", "structid.modal.identification"}).isdisjoint(loaded)
    loaded = modules_after(called("identify", study, "--no-report", "--no-explain"), cwd=tmp_path)
    assert {"structid.study.run.run", "structid.forward.frf.problem", "structid.external"} <= loaded
    assert drawing.isdisjoint(loaded)
    unused = {
        "structid.external.runs", "structid.study.run.solver", "structid.forward.time.identify_time",
        "structid.modal.formats.files", "structid.fem.meshes.nastran", "structid.fem.importers.dmig",
        "structid.records.formats.uff.uff", "structid.records.formats.mat",
        "structid.records.formats.loggers", "structid.fem.elements.shell", "structid.fem.meshes.mesh",
        "structid.study.schema.model.solver", "structid.study.schema.model.matrices",
        "structid.study.schema.records.histories", "structid.inversion.intervals.profile",
        "structid.inversion.intervals.sampling",
    }  # fmt: skip
    assert all(map(find_spec, unused))  # a module that has another name now is never loaded
    assert unused & loaded == set()
