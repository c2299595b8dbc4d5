"""A process of its own that reads files through compiled libraries, so that damage ends it and not the program.

It is run as a script by `structid.files.contained` and imports nothing of structid at first, so that it starts quickly. A
request is a line of JSON; the answer is a line of JSON, and the arrays in it behind it as bytes.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
import psutil

if TYPE_CHECKING:  # it starts without them
    import h5py
    from scipy import sparse

    from structid.core.json_types import JsonValue, StoredEntry

_DENSEST = 1032  # bytes that deflate can make of one
_MOST_ENTRIES = 4096  # of an attribute that is kept
_HEADROOM = 2**30
#: Name of an error that a mistake of this package caused.
SLIP = "slip"


def plain(value: StoredEntry, arrays: list[np.ndarray]) -> JsonValue:
    """JSON of `value`, a tree of mappings, lists, numbers, texts and arrays; its arrays are appended to `arrays`.

    An array is replaced by {"array": index in `arrays`}, a mapping by {"map": ...}, a list by {"list": ...}, so that
    the tree can be filled again. NumPy numbers become those of Python.
    """
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, Mapping):
        return {"map": {str(key): plain(entry, arrays) for key, entry in value.items()}}
    if isinstance(value, np.generic):
        return plain(value.item(), arrays)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return {"list": [plain(entry, arrays) for entry in value]}
    return value


def fill_tree(value: JsonValue, array: Callable[[int], np.ndarray]) -> StoredEntry:
    """The tree of mappings, lists, numbers, texts and arrays that stands in JSON as `value`.

    There, "map", "list" and "array" say what an object is; the function `array` returns each array by its index.
    """
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return array(int(value["array"]))
    if "map" in value:
        return {key: fill_tree(entry, array) for key, entry in value["map"].items()}
    return [fill_tree(entry, array) for entry in value["list"]]


class UnusableError(Exception):
    """The file is whole, and what is asked for cannot be taken from it."""


def hdf5_shapes(path: str) -> dict[str, StoredEntry]:
    """Shape, type and position in the file of every dataset, as [shape, type, byte], by its path without the leading slash.

    The type is "text" or that of NumPy, such as "<f8"; `byte` is where the values begin, or None where they do not lie in one
    piece as they are. Datasets without a shape are left out. `UnusableError` if the file has links to other files.
    """
    import h5py

    entries: dict[str, StoredEntry] = {}

    def note(name: str, item: h5py.Dataset | h5py.Group) -> None:
        """Add [shape, type, position] of the dataset `item` to `entries` by its `name`.

        The position is the byte where values begin, None if they lie in no one piece. Groups and datasets without a
        shape are passed over.
        """
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            dtype = _complex_type(item.dtype)
            text = h5py.check_string_dtype(item.dtype) is not None
            whole = dtype == item.dtype and not text and not item.dtype.hasobject and _why_unusable(item) is None
            offset = item.id.get_offset() if whole and item.chunks is None else None
            form = f"|V{dtype.itemsize}" if dtype.hasobject else dtype.str
            entries[name] = [list(item.shape), "text" if text else form, offset]

    with h5py.File(path, "r") as file:
        _require_own_links(file)
        file.visititems(note)
    return entries


def hdf5_attributes(path: str) -> dict[str, StoredEntry]:
    """Attributes of datasets, groups and the HDF5 file at `path` itself, by ``path@name``.

    Values are lists of texts or arrays (n,). Attributes of more than 4096 entries, and of other types, are left out.
    `UnusableError` if the file has links to other files.
    """
    import h5py

    attributes: dict[str, StoredEntry] = {}

    def note(name: str, item: h5py.Dataset | h5py.Group) -> None:
        """Add attributes of `item`, a dataset or group, to `attributes` as ``name@key``, texts as lists.

        Numbers are (n,). Attributes of more than 4096 entries, of none and of other types are left out.
        """
        for key in item.attrs:
            value = item.attrs[key]
            entries = np.ravel(value).tolist() if np.size(value) <= _MOST_ENTRIES else []
            texts = [t.decode("utf-8", "replace") if isinstance(t, bytes) else t for t in entries]
            if texts and all(isinstance(text, str) for text in texts):
                attributes[f"{name}@{key}"] = texts
            elif texts and np.asarray(value).dtype.kind in "fiu":
                attributes[f"{name}@{key}"] = np.ravel(value)

    with h5py.File(path, "r") as file:
        _require_own_links(file)
        note("", file)
        file.visititems(note)
    return attributes


def hdf5_fields(path: str, names: list[str]) -> dict[str, StoredEntry]:
    """Datasets called `names` that the HDF5 file at `path` has, by name: arrays of numbers, a text, or lists of texts.

    Names that it lacks are left out. `UnusableError` if it has links to other files, or values that are not in it.
    """
    import h5py

    with h5py.File(path, "r") as file:
        _require_own_links(file)
        return {name: _read_field(file[name]) for name in names if name in file}


def hdf5_part(path: str, name: str, begin: int, stop: int, axis: int) -> np.ndarray:
    """Entries `begin` to `stop` (exclusive) along `axis` 0 or 1 of the two-dimensional dataset `name` of an HDF5 file.

    The result is (stop - begin, n) or (n, stop - begin). `UnusableError` if values are in other files.
    """
    import h5py

    with h5py.File(path, "r") as file:
        _require_own_links(file)
        dataset = file[name]
        _require_own_values(dataset)
        return np.asarray(dataset[begin:stop] if axis == 0 else dataset[:, begin:stop])


def matlab_73(path: str) -> dict[str, StoredEntry]:
    """Every variable of numbers or texts of the MAT file at `path` of version 7.3 (HDF5), by name.

    Fields of a struct are named ``name.field``. `UnusableError` if the file has links to other files.
    """
    import h5py

    variables: dict[str, StoredEntry] = {}

    def note(name: str, item: h5py.Dataset | h5py.Group) -> None:
        """Add the variable in the dataset `item` to `variables` by its `name`, with points for slashes.

        MATLAB's own groups, and what is no variable, are left out.
        """
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            field = _read_field_73(item.file, item)
            if field is not None:
                variables[name.replace("/", ".")] = field

    with h5py.File(path, "r") as file:
        _require_own_links(file)
        file.visititems(note)
    return variables


def matlab(path: str) -> dict[str, StoredEntry]:
    """Every variable of numbers or texts of the MAT file at `path` before version 7.3, by name.

    Fields are named ``name.field``. A sparse matrix is a dictionary of its shape, starts of columns, rows and
    values. Other variables are left out.
    """
    from scipy.io import loadmat

    variables: dict[str, StoredEntry] = {}
    for name, value in loadmat(path).items():
        if not name.startswith("__"):
            _note_matlab(variables, name, value)
    return variables


def _note_matlab(variables: dict[str, StoredEntry], name: str, value: np.ndarray | sparse.csc_array) -> None:
    """Add the MATLAB variable `value` to `variables` by its `name`, or each field of a struct as ``name.field``.

    A sparse matrix becomes a dictionary of its shape, starts of columns, rows and values. Objects, arrays of structs,
    and cells of other things than texts are left out.
    """
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    if isinstance(value, MatlabOpaque | MatlabObject | MatlabFunction):
        return
    if not isinstance(value, np.ndarray):
        stored = value.tocsc()
        shape = np.array(stored.shape)
        variables[name] = {"shape": shape, "starts": stored.indptr, "rows": stored.indices, "values": stored.data}
    elif value.dtype.names:
        for field in value.dtype.names if value.size == 1 else ():
            _note_matlab(variables, f"{name}.{field}", value[field].item())
    elif value.dtype.kind == "O":
        cells: dict[str, StoredEntry] = {}
        for index, cell in enumerate(value.ravel(order="F")):
            _note_matlab(cells, str(index), cell)
        texts = [cell for cell in cells.values() if isinstance(cell, str)]
        if len(texts) == value.size:
            variables[name] = texts
    else:
        variables[name] = "".join(value.ravel().tolist()) if value.dtype.kind == "U" else value


def _require_own_links(file: h5py.File) -> None:
    """Raise `UnusableError`, which names the first one, if the HDF5 file has a link to another file."""
    import h5py

    linked: list[str] = []
    file.visititems_links(lambda name, link: linked.append(name) if isinstance(link, h5py.ExternalLink) else None)
    if linked:
        raise UnusableError(
            f"{linked[0]!r} is a link to another file, which is not followed; copy its data into this file"
        )


def _why_unusable(dataset: h5py.Dataset) -> str | None:
    """The reason why the values of a dataset cannot be read from its file; None if they can."""
    if dataset.external:
        return "has its values in another file, which is not read; copy them into this file"
    if dataset.is_virtual:
        return "is put together from other files, which are not read; copy its values into this file"
    if dataset.size and not dataset.id.get_storage_size():
        return "was never written: it has a shape and no values; write the file again"
    return None


def _require_own_values(dataset: h5py.Dataset) -> None:
    """Raise `UnusableError` if values of a dataset are elsewhere or missing, `ValueError` if the file cannot hold them.

    It cannot if they take more than 1032 times the size of the file, the most that compression makes of a byte.
    """
    reason = _why_unusable(dataset)
    if reason is not None:
        raise UnusableError(f"{dataset.name[1:]!r} {reason}")
    declared, file_size = math.prod(dataset.shape) * dataset.dtype.itemsize, Path(dataset.file.filename).stat().st_size
    if declared > _DENSEST * file_size:
        raise ValueError(f"{dataset.name[1:]!r} declares {declared} bytes in a file of {file_size}")


def _read_field(dataset: h5py.Dataset) -> np.ndarray | str | list[str]:
    """Values of an HDF5 dataset: an array of numbers (complex where it is a pair of parts), a text, or a list of texts.

    `UnusableError` if values are elsewhere or missing, `ValueError` if the file cannot hold them. An array of texts is
    flattened.
    """
    import h5py

    _require_own_values(dataset)
    if h5py.check_string_dtype(dataset.dtype) is None:
        return _as_complex(np.asarray(dataset[()]))
    texts = dataset.asstr("utf-8")[()]
    return texts if isinstance(texts, str) else [str(text) for text in texts.ravel()]


def _read_field_73(file: h5py.File, dataset: h5py.Dataset) -> np.ndarray | str | list[str] | None:
    """A variable in MATLAB's HDF5 conventions: an array, a text, or a list of texts; None if it is anything else.

    Axes are reversed in the file, characters are stored as codes, and cells as references into `file`; cells of
    anything but texts are None.
    """
    matlab_class = dataset.attrs.get("MATLAB_class", b"")
    if matlab_class == b"char" and dataset.attrs.get("MATLAB_empty", 0):
        return ""
    if matlab_class not in (b"char", b"cell") and dataset.dtype.kind not in "fciuV":
        return None
    _require_own_values(dataset)
    if matlab_class == b"char":
        return np.asarray(dataset[()]).T.astype("<u2").tobytes().decode("utf-16-le")
    if matlab_class == b"cell":
        cells = [_read_field_73(file, file[reference]) for reference in np.asarray(dataset[()]).T.ravel()]
        return [str(cell) for cell in cells] if all(isinstance(cell, str) for cell in cells) else None
    return _as_complex(np.asarray(dataset[()])).T


def _complex_type(dtype: np.dtype) -> np.dtype:
    """complex128 for a compound type of real and imaginary parts, else `dtype`."""
    names = tuple(name.lower() for name in dtype.names or ())
    return np.dtype(np.complex128) if names in (("real", "imag"), ("r", "i"), ("re", "im")) else dtype


def _as_complex(array: np.ndarray) -> np.ndarray:
    """A structured `array` of the fields (r, i), (re, im) or (real, imag) as complex numbers, same shape; others unchanged."""
    if array.dtype.names and _complex_type(array.dtype) != array.dtype:
        real, imaginary = array.dtype.names
        return np.asarray(array[real] + 1j * array[imaginary])
    return array


def ansys(path: str) -> dict[str, StoredEntry]:
    """Contents of the Ansys file at `path` by name: matrices from ``.full``, element matrices from ``.emat``.

    Of ``.full``: ``dofs``, node and component (from 0) of each row, ``held``, those of constrained rows, and
    ``STIFFNESS`` and ``MASS`` if there, one triangle each as [shape, column starts, rows, values]. Of ``.emat``:
    ``nodes`` and ``labels``, those of nodes and of elements by index, ``n_dof``, the components of a node, and
    ``elements``, for each a pair of equation numbers and values by kind of matrix.
    """
    from ansys.mapdl.reader import read_binary

    opened = read_binary(path)
    if path.lower().endswith(".full"):
        dofs, stiffness, mass = opened.load_km(sort=True)
        assembled: dict[str, StoredEntry] = {
            "dofs": np.asarray(dofs, np.int64),
            "held": np.asarray(opened.const, np.int64),
        }
        for name, matrix in (("STIFFNESS", stiffness), ("MASS", mass)):
            if matrix is not None:
                compact = matrix.tocsc()
                assembled[name] = [list(compact.shape), compact.indptr, compact.indices, compact.data]
        return assembled
    elements: list[list[np.ndarray | dict[str, np.ndarray]]] = []
    for index in range(opened.n_elements):
        equations, data = opened.read_element(index)
        parts = {key: np.asarray(values, np.float64) for key, values in data.items()}
        elements.append([np.asarray(equations, np.int64), parts])
    nodes, labels = np.asarray(opened.neqv, np.int64), np.asarray(opened.eeqv, np.int64)
    return {"nodes": nodes, "labels": labels, "n_dof": int(opened.n_dof), "elements": elements}


def logger(path: str, kind: str) -> StoredEntry:
    """Channels of a logger's file of the given `kind`, read by its library."""
    from structid.files.loggers import logger as read  # with a library that takes its time: only when it is asked for

    return read(path, kind)


READERS: dict[str, Callable[..., StoredEntry]] = {
    reader.__name__: reader
    for reader in (hdf5_shapes, hdf5_attributes, hdf5_fields, hdf5_part, matlab, matlab_73, ansys, logger)
}


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer the requests in the stream `requests`, one line of JSON each, on the stream `answers`, until none is left.

    A request has reader, path, options and seconds. The first answer is "ready"; each other one is a line of JSON with
    a tree and the types and shapes of arrays, or an error in words, and then the bytes of the arrays.
    """
    answers.write(b"ready\n")
    answers.flush()
    for line in requests:
        request = json.loads(line)
        arrays: list[np.ndarray] = []
        try:
            _limit_memory(request["path"])
            _limit_time(request["seconds"])
            tree = plain(READERS[request["reader"]](request["path"], **request["options"]), arrays)
            arrays = [np.ascontiguousarray(array) for array in arrays]
            if any(array.dtype.kind not in "biufcSU" for array in arrays):
                raise ValueError("it holds arrays of neither numbers nor texts")
            answer = {"tree": tree, "arrays": [[array.dtype.str, list(array.shape)] for array in arrays]}
        except Exception as error:  # whatever a library raises on damage: it is told in the program
            name = SLIP if _is_slip(error) else type(error).__name__
            answer, arrays = {"error": name, "words": " ".join(str(error).split())[:300]}, []
        answers.write(json.dumps(answer).encode("ascii") + b"\n")
        for array in arrays:
            answers.write(array.reshape(-1).view(np.uint8).data)
        answers.flush()


def _is_slip(error: Exception) -> bool:
    """True if a reader of this package itself raised an `error` that no content of a file explains.

    A `TypeError` is none: compiled code, which leaves no frame, raises it on the contents of a file.
    """
    if not isinstance(error, AttributeError | NameError | AssertionError):
        return False
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    return frame is not None and Path(frame.tb_frame.f_code.co_filename).parent == Path(__file__).parent


def _limit_memory(path: str) -> None:
    """Limit this process's address space to what the file at `path` can plausibly hold.

    The limit is what is in use, 1 GiB, and 2064 times the size of the file. Nothing is limited on Windows.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    used = psutil.Process().memory_info().vms
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    wanted = used + _HEADROOM + 2 * _DENSEST * Path(path).stat().st_size
    resource.setrlimit(resource.RLIMIT_AS, (wanted if most == resource.RLIM_INFINITY else min(wanted, most), most))


def _limit_time(seconds: float) -> None:
    """Limit this process's processor time for the next request to about `seconds`, where the system has such limits."""
    try:
        import resource
    except ImportError:  # Windows
        return
    used, (_, most) = time.process_time(), resource.getrlimit(resource.RLIMIT_CPU)
    wanted = math.ceil(used + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (wanted if most == resource.RLIM_INFINITY else min(wanted, most), most))


if __name__ == "__main__":
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    serve(sys.stdin.buffer, channel)
