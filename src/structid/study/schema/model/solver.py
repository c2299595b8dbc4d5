"""``[structure.solver]``: a deck with marked parameters, the command that runs it, and what comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid import external
from structid.core.arrays import FloatArray
from structid.core.constraints import Limits
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.core.json_types import JsonValue
from structid.core.units import FORCES, LENGTHS
from structid.external.confirmation import command_words, confirmation_of
from structid.external.deck import Deck, DeckParameter, MatrixFile, deck_texts, with_frequencies
from structid.external.marks import CardField, DeckMark, DeckPosition, KeywordEntry, value_at, with_marks
from structid.fem.meshes import read_mesh
from structid.identification.options import IdentifyOptions
from structid.identification.setups.frf import used_lines
from structid.modal.formats.options import PUNCH_SUFFIXES
from structid.records import FrfRecord
from structid.study.schema.method import read_method
from structid.study.schema.records.record import load_record, read_source
from structid.study.schema.section import InputFiles, Section, record_sections
from structid.study.schema.tables import (
    BOOLEAN,
    NUMBER,
    TEXT,
    TEXTS,
    WHOLE,
    Given,
    Key,
    Kind,
    Schema,
    Table,
    as_list,
    choice,
    limit_kind,
    list_of,
    table_of,
)

_MATRICES = ("stiffness", "mass", "damping")
_FILE = Kind(
    'a file that the solver writes, or a table such as { path = "{stem}.op4", matrix = "KAA" }',
    {"anyOf": [TEXT.schema, table_of(MatrixFile).schema]},
)
#: Keys that belong to one kind of what comes out.
_OF_KIND = {"matrices": (*_MATRICES, "dofs", "indefinite"), "modes": ("modes",), "frfs": ("frfs", "loads")}
_PLACES: Schema = {"anyOf": [table_of(CardField).schema, table_of(KeywordEntry).schema]}
_MARK = Kind(
    'a place such as { card = "MAT1", id = 1, field = 3 } or { keyword = "*ELASTIC", of = "*MATERIAL, NAME=STEEL",'
    " entry = 1 }, or a list of places",
    {"anyOf": [*_PLACES["anyOf"], list_of(_PLACES)]},
)
_PARAMETER = table_of(DeckParameter) | {
    "value": Key(NUMBER, "Nominal value, in the units of the deck; with `mark`, what the deck holds there by default"),
    "mark": Key(_MARK, "Where the number stands in a deck without {{name}}"),
}
SOLVER = Table(
    {
        "name": Key(TEXT, "Of the element set that the model becomes", default="model"),
        "deck": Key(
            TEXTS,
            "The deck, its parameters marked by {{name}} or `mark`; of several files, the first is the one that is run",
            required=True,
        ),
        "files": Key(TEXTS, "Further files that the solver reads, copied as they are"),
        "command": Key(
            TEXT, "What runs the solver, with {deck}, {stem} (deck without suffix) and {study} (folder)", required=True
        ),
        "gives": Key(choice("matrices", "modes", "frfs"), "What comes out", default="matrices"),
        **{key: Key(_FILE, f"Where the {key} matrix is, with {{stem}}") for key in _MATRICES},
        "dofs": Key(TEXTS, "What the rows of matrices stand for: a file that the solver writes, or a list"),
        "modes": Key(TEXT, "File of frequencies and shapes, with {stem}: .frd, .f06, .csv, .json or .uff"),
        "frfs": Key(
            TEXT, "File of complex FRFs at the lines of the record, with {stem}: .csv, .uff, .npz, .h5 or .pch"
        ),
        "loads": Key(TEXTS, "Of FRFs in a punch file: what acts in each subcase, with a size of 1"),
        "length_unit": Key(choice(*LENGTHS), "Of the deck", default="m"),
        "force_unit": Key(choice(*FORCES), "Of the deck", default="N"),
        "indefinite": Key(BOOLEAN, "Lets matrices through that are not positive semidefinite", default=False),
        "timeout": Key(
            replace(limit_kind(NUMBER, Limits(above=0)), remedy="leave it out for one hour"),
            "Longest time of a run, s",
            default=3600.0,
        ),
        "retries": Key(limit_kind(WHOLE, Limits(least=0)), "How often a run that fails is tried again", default=2),
        "runs": Key(TEXT, "Folder where finished runs are kept; STUDY.runs beside the study by default"),
        "parameter": Key(_PARAMETER, "A marked number of the deck, which [[unknown]] may name", listed=True),
    }
)
#: Sections of a record for which FRFs alone do not do, and what stands in place of each.
_NOT_OF_FRFS = {
    "modes": "measured modes ask for modes of the solver",
    "time": "time histories are fitted by matrices or modes of the solver; average them by [record.frf]",
    "structure": "a structure that differs from record to record asks for matrices or modes of the solver",
    "sensors": "sensors that are turned ask for matrices or modes of the solver; let it write FRFs in their directions",
    "leakage": "leakage is taken into account by matrices or modes of the solver",
    "window_decay": "a window is taken into account by matrices or modes of the solver; correct the record for it",
}


def read_solver(section: Section, files: InputFiles) -> external.SolvedModel | None:
    """The results of the solver runs of ``[structure.solver]``, made once for all records; None without a solver.

    Parameters
    ----------
    section : Section
        ``[structure]``.
    files : InputFiles
        List of input files, to which those read are added; it keeps the results.

    Raises
    ------
    InputError
        If deck and parameters disagree, the solver is missing or fails, or no model can be made of its output.
    """
    solver_section = section.section("solver")
    if solver_section is None:
        return None
    if not files.solved:
        files.solved.append(_run_solver(solver_section, files))
    return files.solved[0]


def _run_solver(section: Section, files: InputFiles) -> external.SolvedModel:
    """The model that the solver's runs give, of FRFs, modes or matrices, as ``gives`` in the section says.

    Deck, outputs and command are read from ``[structure.solver]``; input files are added to `files`. `InputError` if a
    key or file cannot be used, or a run fails.
    """
    values = SOLVER.defaults | section.values(SOLVER)
    with section.located("deck"):
        texts = deck_texts([files.path(name) for name in as_list(values["deck"])])
    parameters, texts = _read_parameters(section, texts)
    stem = {"stem": Path(next(iter(texts))).stem}
    out = _read_outputs(section, values, stem, files)
    with section.located("deck"):
        deck = Deck(
            with_frequencies(texts, out.frequency.tolist()) if isinstance(out, external.FrfsOut) else texts, parameters
        )
    linked = {Path(name).name: files.path(name) for name in as_list(values.get("files", []))}
    inputs = [*(files.path(name) for name in as_list(values["deck"])), *linked.values()]
    folder = files.folder / values.get("runs", f"{section.source.path.stem}.runs")
    with section.located("command"):
        confirmation = confirmation_of(values["command"], files.folder, inputs)
    solver = external.Solver(
        deck, values["command"], folder, files.folder, linked, out, values["timeout"], values["retries"], confirmation
    )
    name, units = values["name"], external.Units(values["length_unit"], values["force_unit"])
    with section.located():
        if isinstance(out, external.FrfsOut):
            return external.solved_frfs(name, solver, out, units, files.work)
        if isinstance(out, external.ModesOut):
            return external.solved_modes(name, solver, out, units, files.work)
        return external.solved_matrices(name, solver, out, units, files.work, values["indefinite"])


class SolverCommand(NamedTuple):
    """The command of a study as written and as `words` to run, its input files by name, and the digest to confirm."""

    command: str
    words: list[str]
    inputs: list[str]
    confirmation: str


def solver_command(root: Section, files: InputFiles) -> SolverCommand | None:
    """The command that a study runs, in words, its input files and the digest that a user confirms.

    None without a solver. Nothing is run.

    Raises
    ------
    InputError
        If ``[structure.solver]`` cannot be used, or a deck or file is missing.
    """
    section = root.inner("structure").section("solver")
    if section is None:
        return None
    values = section.values(SOLVER)
    command, names = values["command"], [*as_list(values["deck"]), *as_list(values.get("files", []))]
    inputs = [files.path(name) for name in names]
    with section.located("command"):
        words = command_words(command, inputs[0].name, files.folder)
        return SolverCommand(command, words, names, confirmation_of(command, files.folder, inputs))


def _read_parameters(section: Section, texts: Mapping[str, str]) -> tuple[list[DeckParameter], dict[str, str]]:
    """The parameters of the deck, and the texts of its files by name, with each parameter marked in them.

    `texts` are those of the files as they are. A parameter without ``value`` has the number at its marks. `StudyError`
    if there is none, or one has neither value nor mark.
    """
    entries = section.sections("parameter")
    if not entries:
        raise section.error(
            "has no parameter; add [[structure.solver.parameter]] with `name` and `value`, and mark it in the deck"
        )
    parameters, marked = [], []
    for entry in entries:
        values = entry.values(_PARAMETER)
        deck_positions = _find_positions(entry, values.pop("mark", []), texts)
        if not deck_positions and "value" not in values:
            raise entry.error("`value` is missing; add the nominal value, or `mark`, where the deck holds it")
        with entry.located():
            value = values.pop("value") if "value" in values else value_at(values["name"], deck_positions)
            parameters.append(DeckParameter(**values, value=value))
        marked += [(values["name"], position) for position in deck_positions]
    with section.located("parameter"):
        return parameters, with_marks(texts, marked)


def _find_positions(entry: Section, marks: JsonValue, texts: Mapping[str, str]) -> list[DeckPosition]:
    """Positions of a parameter in the deck, one for each of its `marks` (a table or a list of tables).

    A mark names a card and field, or a keyword and entry. `texts` are the files of the deck by name. `StudyError` if a
    mark fits no position in them, or several.
    """
    found_positions = []
    for k, table in enumerate(marks if isinstance(marks, list) else [marks]):
        path = (*entry.path, "mark", *((k,) if isinstance(marks, list) else ()))
        section = Section(entry.source, path, table)
        mark: DeckMark = section.read(CardField) if "card" in table else section.read(KeywordEntry)
        with entry.located("mark"):
            found_positions.append(mark.locate(texts))
    return found_positions


def _read_outputs(
    section: Section, values: Given, stem: Mapping[str, str], files: InputFiles
) -> external.MatricesOut | external.ModesOut | external.FrfsOut:
    """The output that the study expects of a run: matrices, modes or FRFs.

    `values` are the values of the section, `stem` fills file names. `StudyError` for a key of another kind of output,
    or a missing one. For FRFs the records are read, and added to `files`.
    """
    gives = values["gives"]
    for kind, keys in _OF_KIND.items():
        for key in keys:
            if kind != gives and key in section.table:
                raise section.error(f'belongs to `gives = "{kind}"`; take it out', key)
    if gives == "frfs":
        if "frfs" not in values:
            raise section.error(
                '`frfs` is missing; add `frfs = "{stem}.csv"`, the file of complex FRFs that the solver writes'
            )
        name = _output_name(section, "frfs", values["frfs"], stem)
        is_punch = Path(name).suffix.lower() in PUNCH_SUFFIXES
        for key in ("length_unit", "force_unit", "loads"):
            if key in section.table and not is_punch:
                raise section.error(
                    "is for punch files; a file of FRFs says its units and loads itself; take it out", key
                )
        if is_punch and "loads" not in values:
            raise section.error('`loads` is missing; add `loads = ["3Z"]`, what acts in each subcase with a size of 1')
        with section.located("loads"):
            loads = parse_dofs(as_list(values.get("loads", [])))
        units = external.Units(values["length_unit"], values["force_unit"])
        return external.FrfsOut(name, *wanted_frfs(section, files), loads, units)
    if gives == "modes":
        if "modes" not in values:
            raise section.error('`modes` is missing; add `modes = "{stem}.frd"`, the file of frequencies and shapes')
        return external.ModesOut(_output_name(section, "modes", values["modes"], stem))
    for key in ("stiffness", "mass"):
        if key not in values:
            raise section.error(
                f'`{key}` is missing; add `{key} = "{{stem}}.{"sti" if key == "stiffness" else "mas"}"`, the file of it'
            )
    matrices = {}
    for key in _MATRICES:
        if key in values:
            plain_name = values[key] if isinstance(values[key], str) else None
            entry = (
                MatrixFile(plain_name)
                if plain_name is not None
                else Section(section.source, (*section.path, key), values[key]).read(MatrixFile)
            )
            matrices[key] = MatrixFile(_output_name(section, key, entry.path, stem), entry.matrix)
    numbering = None
    if "dofs" in values:
        text = values["dofs"]
        with section.located("dofs"):
            numbering = _output_name(section, "dofs", text, stem) if isinstance(text, str) else parse_dofs(text)
    return external.MatricesOut(matrices, numbering)


def _output_name(section: Section, key: str, text: str, stem: Mapping[str, str]) -> str:
    """A file name in the folder of a run, from `text` with ``{stem}`` filled in.

    `StudyError` if it has folders or other braces. `key` is named in errors; `stem` has the deck's name without its
    suffix, under the key "stem".
    """
    try:
        name = text.format(**stem)
    except (KeyError, ValueError, IndexError) as error:
        raise section.error(f"{text!r} may hold {{stem}} only, the deck's name without its suffix", key) from error
    if Path(name).name != name or name in ("", ".", ".."):
        raise section.error(f"{name!r} must be the name of a file in the folder of a run, without folders", key)
    return name


def positions_of(solved: external.SolvedModel) -> dict[int, list[float]]:
    """Position of each node of the model, [x, y, z] in m by label, from the deck if its mesh can be read.

    Nodes without a position there are at the origin.
    """
    deck = solved.solver.deck
    try:
        mesh = read_mesh(solved.solver.run_folder(solved.at) / deck.main, solved.units.length)
        positions = {label: position.tolist() for label, position in mesh.nodes.items()}
    except InputError:
        positions = {}
    return {node: positions.get(node, [0.0, 0.0, 0.0]) for node in solved.nodes}


class WantedFrfs(NamedTuple):
    """Lines (n_lines,), Hz, sensors and loads that the records need of a solver, each once."""

    frequency: FloatArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]


def wanted_frfs(section: Section, files: InputFiles) -> WantedFrfs:
    """The lines and channels that all records need from the solver: only lines in the band or the evaluation band.

    Lines are in Hz, increasing, each once; channels are along positive directions.

    Parameters
    ----------
    section : Section
        ``[structure.solver]``.
    files : InputFiles
        List of input files, to which the records are added.

    Raises
    ------
    StudyError
        If there is no record, or one that FRFs of a solver cannot explain, or ``[structure]`` has more than nodes and
        the solver.
    """
    root = Section(section.source, (), section.source.table)
    structure = root.inner("structure")
    for key, value in structure.table.items():
        if key == "tolerance" and value != 0:
            raise structure.error(
                "cannot be carried where a solver gives FRFs alone, which do not say what its model holds: leave it out, or write"
                ' 0; the `calibration` of a [record] is carried, and `gives = "matrices"` or `"modes"` carries tolerances',
                key,
            )
        if key not in ("solver", "nodes", "tolerance"):
            raise structure.error(
                "stands beside a solver that gives FRFs alone, so that it cannot act on them; put it in the deck, or take `gives ="
                ' "matrices"` or `"modes"`',
                key,
            )
    sections = record_sections(root)
    if not sections:
        raise section.error(
            '`gives = "frfs"` needs a [record]: it says at which lines and places the solver is to give FRFs'
        )
    options = read_method(root.section("method"))
    records = [_read_frf_record(one, files) for one in sections]
    lines = [line for record in records for line in _lines(record, options)]
    outputs = tuple(dict.fromkeys(dof.unsigned for record in records for dof in record.outputs))
    inputs = tuple(dict.fromkeys(dof.unsigned for record in records for dof in record.inputs))
    return WantedFrfs(np.unique(lines), outputs, inputs)


def _read_frf_record(section: Section, files: InputFiles) -> FrfRecord:
    """The FRF record that a section describes, for a solver that gives FRFs of motion per force.

    `StudyError` if the section has a key that such a fit cannot use, or the record holds transmissibilities.
    """
    for key, words in _NOT_OF_FRFS.items():
        if key in section.table:
            raise section.error(f'is nothing for a solver with `gives = "frfs"`: {words}', key)
    record = load_record(read_source(section, files))
    if record.is_per_motion:
        raise section.error(
            'holds transmissibilities, and the solver gives motion per force; take `gives = "matrices"`'
        )
    return record


def _lines(record: FrfRecord, options: IdentifyOptions) -> list[float]:
    used = used_lines(record, options).frequency.tolist()
    return used if options.evaluation_band is None else used + record.band(*options.evaluation_band).frequency.tolist()
