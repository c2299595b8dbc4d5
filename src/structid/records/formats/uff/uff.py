"""Universal files: functions at nodal degrees of freedom (datasets 58 and 58b) with their units (164).

What is kept: values, frequencies or sampling rate, degrees of freedom with their sense, kinds, coherence, and
`averages`. Not kept: `variance`, `noise_source`, `source`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from structid.core.dof import DIRECTIONS
from structid.core.errors import FileError, InputError, StoredSpectraError, about
from structid.files import atomic_write
from structid.files.uff.datasets import UffDataset, read_blocks, read_unit_factors
from structid.files.uff.geometry import UniversalNodes, read_nodes
from structid.records.formats.geometry import Geometry
from structid.records.formats.named_channels import choose_columns
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.selection import refuse_options
from structid.records.formats.uff.frf import read_frfs
from structid.records.formats.uff.functions import Dataset58, qualifier_words, read_function, require_one_component
from structid.records.formats.uff.time import read_times
from structid.records.formats.uff.write import file_bytes, require_same
from structid.records.record import FrfRecord, TimeRecord

_DIRECTIONS = {sign * (i + 1): f"{d}{'+' if sign > 0 else '-'}" for i, d in enumerate(DIRECTIONS) for sign in (1, -1)}
_FUNCTIONS = {
    0: "general function", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "frequency response function",
    5: "transmissibility", 6: "coherence", 7: "auto correlation", 8: "cross correlation", 9: "power spectral density",
    10: "energy spectral density", 12: "spectrum", 18: "mode indicator function", 24: "shock response spectrum",
    26: "multiple coherence", 27: "order function",
}  # fmt: skip
_TIME, _COHERENCE = 1, 6
_RESPONSES = (4, 5)
_SPECTRA, _CORRELATIONS = (2, 3, 9), (7, 8)
#: Numbers of the datasets that may hold modes.
_MODES = (55, 2414)
_OF_FRFS = ("frequency_array", "outputs", "inputs", "kind", "unit", "coherence_array", "averages")
_OF_TIMES = ("channels", "quantities", "units", "start", "stop", "longest_gap", "resample", "sampling_rate")


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the universal file at `path`, in SI units.

    FRFs (function types 4 and 5) become one record of all outputs and inputs, with coherence (6) where every pair has
    it; time responses (1) become one record of all channels; `options.columns` chooses functions by their numbers.
    Sensors and loads are turned into global axes where their nodes (15, 2411) have coordinate systems (18, 2420) of
    their own. Units come from labels and dataset 164; the record's `source` says what was converted, turned or left
    aside.

    Raises
    ------
    FileError
        If the file is truncated or damaged, does not say its units, holds neither FRFs nor time responses, or pairs are
        missing or doubled.
    InputError
        If it holds both FRFs and time responses and `options.array` is neither "frf" nor "time", or an option does not
        apply.
    """
    blocks = read_blocks(path)
    tables = [block for block in blocks if block.number == 58]
    functions = [read_function(path, block, ordinal) for ordinal, block in enumerate(tables, 1)]
    chosen_functions = _choose_functions(path, functions, options)
    if not (options.columns and (options.channels or options.outputs)):
        require_one_component(path, chosen_functions)
    frfs = [f for f in chosen_functions if f.kind in _RESPONSES]
    times = [f for f in chosen_functions if f.kind == _TIME]
    if frfs and times and options.array not in ("frf", "time"):
        raise InputError(
            f"{path}: holds {len(frfs)} FRFs and {len(times)} time responses; choose with "
            f'{option_words(array=None)}, "frf" or "time"'
        )
    if not frfs and not times:
        raise _no_response_error(path, chosen_functions, blocks)
    takes_units = not options.unit if frfs and options.array != "time" else not options.units
    factors = read_unit_factors(path, blocks) if takes_units else None
    nodes = None if options.axes == "named" else _nodes(path, blocks)
    if frfs and (not times or options.array == "frf"):
        refuse_options(path, "frequency response functions", options, _OF_TIMES)
        coherences = [f for f in functions if f.kind == _COHERENCE]
        record, has_coherence = read_frfs(path, frfs, coherences, factors, nodes, options)
        used = {*_RESPONSES, _COHERENCE} if has_coherence else set(_RESPONSES)
    else:
        refuse_options(path, "time histories", options, _OF_FRFS)
        record, used = read_times(path, times, factors, nodes, options), {_TIME}
    words_of_windows = qualifier_words(path, blocks, {f.ordinal for f in chosen_functions if f.kind in used})
    if words_of_windows:
        record = replace(record, source=f"{record.source}; {words_of_windows}")
    left_aside = Counter(f.kind for f in functions if f.kind not in used)
    words = [f"{_name(kind)} ({n})" for kind, n in sorted(left_aside.items())]
    if len(chosen_functions) < len(functions) or not words:
        return record
    return replace(record, source=f"{record.source}; left aside: {', '.join(words)}")


def _name(kind: int) -> str:
    return _FUNCTIONS.get(kind, f"function type {kind}")


def _choose_functions(path: Path, functions: list[Dataset58], options: ReadOptions) -> list[Dataset58]:
    """Functions that `options.columns` chooses from `functions` by number or name, such as ``12Z+``; all if not set.

    They are in the order of the option. A number counts the functions of the file from 1. `InputError` if there is no
    such function, or several have the name.
    """
    if not options.columns:
        return functions
    names = [f"{f.response[0]}{_DIRECTIONS.get(f.response[1], ' direction 0')}" for f in functions]
    numbers = [function.ordinal for function in functions]
    with about("columns"):
        return [functions[i] for i in choose_columns(path, options.columns, names, numbers)]


def _nodes(path: Path, blocks: list[UffDataset]) -> UniversalNodes:
    """Nodes of the file with their axes; errors add that directions may be taken as they are named."""
    try:
        return read_nodes(path, blocks)
    except FileError as error:
        raise FileError(f"{error}; or take directions as they are named: {option_words(axes='named')}") from error


def _no_response_error(path: Path, functions: list[Dataset58], blocks: list[UffDataset]) -> FileError:
    """The error to raise for a file without FRFs and time responses, which names what the file holds.

    It is a `StoredSpectraError` if there are only spectra or only correlation functions, beside coherences. `functions`
    are all datasets 58 of the file, `blocks` all its datasets.
    """
    kinds = sorted({function.kind for function in functions})
    names = ", ".join(map(_name, kinds))
    is_spectra, is_correlations = bool({*kinds} & {*_SPECTRA}), bool({*kinds} & {*_CORRELATIONS})
    if is_spectra and is_correlations:
        return FileError(
            f"{path}: holds spectra and correlation functions ({names}), no histories or FRFs; `structid modes` takes either: say"
            f" which by {option_words(kind=None)}, spectrum or correlation"
        )
    if (is_spectra or is_correlations) and set(kinds) <= {*_SPECTRA, *_CORRELATIONS, _COHERENCE}:
        words = "spectra" if is_spectra else "correlation functions"
        return StoredSpectraError(
            f"{path}: holds {words} of responses ({names}), averaged already and without the time histories behind them, which"
            " are neither frequency response functions (type 4) nor histories (type 1): `structid modes` finds modes in them;"
            " for a fit, export the time histories",
            "spectrum" if is_spectra else "correlation",
        )
    numbers = sorted({block.number for block in blocks})
    others = f"datasets {', '.join(map(str, numbers))}"
    has_modes = not names and bool({*numbers} & {*_MODES})
    return FileError(
        f"{path}: holds no frequency response function (type 4) or time response (type 1), only {names or others};"
        f" {'give modes as such, by [record.modes] of a study' if has_modes else 'export those'}"
    )


def write(path: Path, record: FrfRecord | TimeRecord, geometry: Geometry | None = None) -> None:
    """Write `record` to `path` as a binary universal file (58b) in double precision and SI units, with optional geometry.

    The file is read back and compared before it takes its place.

    Raises
    ------
    FileError
        If the file cannot be written, or does not read back as it should.
    """
    path = Path(path)
    with atomic_write(path) as temporary:
        with temporary.open("wb") as stream:
            stream.writelines(file_bytes(path, record, geometry))
        require_same(path, record, read(temporary, ReadOptions()))
