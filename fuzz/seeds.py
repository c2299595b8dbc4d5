"""Whole files of every kind that structid reads, small, to be damaged."""

from __future__ import annotations

import json
import shutil
import struct
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import h5py
import meshio
import numpy as np
import scipy.io
import scipy.io.wavfile
from scipy import sparse

from fuzz.mutations import ARCHIVE, BINARY, COMPRESSED, STUDY, TEXT, Mutation
from structid.fem.importers import (
    ElementEntries,
    ImportedMatrix,
    Op4Options,
    write_abaqus,
    write_dmig,
    write_matrix,
    write_op4,
)
from structid.files.loggers import PACKAGES
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.records import FrfRecord, TimeRecord
from structid.records.formats import LOGGERS, write_record
from structid.records.formats.geometry import Geometry
from structid.records.formats.layout import fields_of
from structid.study.run.long_run import Checkpoint

EXAMPLES = Path(__file__).parent.parent / "examples"


@dataclass(frozen=True)
class Seed:
    """A whole file, alone or with others beside it in its folder.

    Attributes
    ----------
    name : str
        Kind of file.
    target : str
        What is done with it; see `fuzz.targets`.
    path : Path
        The file to be damaged; its folder is copied with it.
    mutations : tuple of functions
    """

    name: str
    target: str
    path: Path
    mutations: tuple[Mutation, ...]

    def copied(self, place: Path) -> Path:
        """The path in a copy of the folder at `place`."""
        shutil.copytree(self.path.parent, place, dirs_exist_ok=True)
        return place / self.path.name


def make_seeds(folder: Path) -> list[Seed]:
    """Every seed, its files written into `folder`."""
    found: list[Seed] = []
    for make in (
        _records,
        _tables,
        _loggers,
        _bare,
        _matrices,
        _numberings,
        _meshes,
        _modes,
        _spectra,
        _studies,
        _kept,
    ):
        for name, target, file, mutations in make(folder):
            found.append(Seed(name, target, file, mutations))
    return found


#: Bars and plates off their grid points, a laminate, and means of motions.
OFFSET_BULK = """BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
GRID,4,,0.,1.,0.
GRID,5,,2.,.5,1.
GRID,6,,.5,.5,1.
CQUAD4,1,1,1,2,3,4,,.03
PCOMP,1,.001,,,,,,SYM
,1,.004,0.,,1,.006
BAROR,,2,,,0.,1.,0.,GOG
CBAR,7,2,1,5,0.,1.,0.
,,,.1,.2,.3,-.1,0.,.2
RBE3,8,,6,123456,1.,123,1,2
,3,4,.5,123456,5
RBE2,9,5,123456,2,THRU,3
MPCADD,100,1,2
MPC,1,4,1,1.,3,1,-.5
ENDDATA
"""
#: Surfaces that are tied and coupled, and a shell off its nodes.
TIED = """*NODE
1, 0, 0, 0
2, 2, 0, 0
3, 2, 2, 0
4, 0, 2, 0
5, 0, 0, 1
6, 2, 0, 1
7, 2, 2, 1
8, 0, 2, 1
11, 0.5, 0.5, 1.01
12, 1.5, 0.5, 1.01
13, 1.5, 1.5, 1.01
20, 1, 1, 3
*ELEMENT, TYPE=C3D8, ELSET=LOW
1, 1, 2, 3, 4, 5, 6, 7, 8
*ELEMENT, TYPE=S3, ELSET=SK
2, 11, 12, 13
*SURFACE, NAME=TOP
LOW, S2
*SURFACE, NAME=POINTS, TYPE=NODE
11
12
*SHELL SECTION, ELSET=SK, MATERIAL=M, OFFSET=0.5
.1
*TIE, NAME=T
POINTS, TOP
*COUPLING, CONSTRAINT NAME=C, REF NODE=20, SURFACE=TOP
*DISTRIBUTING
1, 6
"""
LISTING = """                R E A L   E I G E N V A L U E S
        1         1        6.168503E+03        7.853982E+01        1.250000E+01        1.000000E+00        6.168503E+03
          CYCLES =  1.250000E+01         R E A L   E I G E N V E C T O R   N O .          1

      POINT ID.   TYPE          T1             T2             T3             R1             R2             R3
             1      G      1.000000E+00   5.000000E-01   0.0            0.0            0.0            0.0
             2      G     -2.500000E-01   5.000000E-01   0.0            0.0            0.0            0.0
"""
PUNCHED = """$EIGENVECTOR
$REAL OUTPUT
$EIGENVALUE =  6.1685028E+03  MODE =     1
         1       G      1.000000E+00      5.000000E-01      0.000000E+00
-CONT-                  0.000000E+00      0.000000E+00      0.000000E+00
"""

COMPLEX_LISTING = """      COMPLEX EIGENVALUE = -1.000000E+00,  7.853982E+01
                                       C O M P L E X   E I G E N V E C T O R   NO.          1
                                                          (MAGNITUDE/PHASE)
      POINT ID.   TYPE          T1             T2             T3             R1             R2             R3
0            1      G      1.000000E+00   5.000000E-01   0.0            0.0            0.0            0.0
                         270.0000       180.0000         0.0            0.0            0.0            0.0
1    FRAME                                                                    MSC.NASTRAN  6/17/05   PAGE    12
"""
RESULTS = """    1PGM                1.000000E+00
  100CL  101 12.50000000           2                     2    1MODAL      1
 -4  DISP        4    1
 -1         1 1.00000E+00-2.50000E-01 0.00000E+00
 -1         2 5.00000E-01 7.50000E-01 0.00000E+00
 -3
 9999
"""
#: A dataset 2414 of a normal mode, with nodes in a cylindrical system, elements and units of mm.
ANALYSIS = """    -1
   164
        10mm                           2
   1.0000000000000000E+03   1.0000000000000000E+00   1.0000000000000000E+00
   2.7314999999999998E+02
    -1
    -1
  2420
         1
part
         5         1         0
CYL
   1.0000000000000000E+00   0.0000000000000000E+00   0.0000000000000000E+00
   0.0000000000000000E+00   1.0000000000000000E+00   0.0000000000000000E+00
   0.0000000000000000E+00   0.0000000000000000E+00   1.0000000000000000E+00
   0.0000000000000000E+00   0.0000000000000000E+00   0.0000000000000000E+00
    -1
    -1
  2411
         1         1         1        11
   1.0000000000000000D+03   0.0000000000000000D+00   0.0000000000000000D+00
         2         5         5        11
   1.0000000000000000D+03   9.0000000000000000D+01   0.0000000000000000D+00
         3         1         1        11
   0.0000000000000000D+00   0.0000000000000000D+00   0.0000000000000000D+00
    -1
    -1
  2412
         1        91         1         1         7         3
         1         2         3
         2        21         1         1         7         2
         0         1         1
         1         2
    -1
    -1
  2467
         1         0         0         0         0         0         0         2
plate
         8         1         0         0         7         3         0         0
    -1
    -1
  2414
         1
shape
         1
NONE
NONE
NONE
NONE
NONE
         1         2         2        12         2         3
         0         0         0         0         0         1         0         0
         0         0
  0.00000E+00  1.25000E+01  6.16850E+03  4.00000E+00  1.00000E-02  0.00000E+00
  0.00000E+00  0.00000E+00  0.00000E+00  0.00000E+00  0.00000E+00  0.00000E+00
         1
  1.00000E+00  5.00000E-01  0.00000E+00
         2
 -2.50000E-01  5.00000E-01  1.00000E+00
    -1
"""

_Made = Iterator[tuple[str, str, Path, tuple[Mutation, ...]]]


def _place(folder: Path, name: str, file: str) -> Path:
    place = folder / name.replace("/", "_")
    place.mkdir(parents=True)
    return place / file


def _random(*shape: int) -> np.ndarray:
    return np.random.default_rng(3).standard_normal(shape)


def _frf() -> FrfRecord:
    values = _random(9, 2, 1) + 1j * _random(9, 2, 1)
    return FrfRecord(
        np.arange(1.0, 10), values, ("1X", "2X"), ("1X",), "mobility", coherence=np.full((9, 2, 1), 0.9), averages=5,
        variance=np.full((9, 2, 1), 0.1), source="hammer",
    )  # fmt: skip


def _history() -> TimeRecord:
    return TimeRecord(10.0, _random(24, 3), ("1X", "2X", "3X"), ("acceleration", "velocity", "force"), source="shaker")


def _records(folder: Path) -> _Made:
    kinds = {".npz": ARCHIVE, ".h5": BINARY, ".mat": COMPRESSED, ".csv": TEXT, ".uff": (*BINARY, *TEXT)}
    for content, record in (("frf", _frf()), ("history", _history())):
        for suffix, mutations in kinds.items():
            name = f"records/{content}{suffix}"
            path = _place(folder, name, f"a{suffix}")
            write_record(path, record)
            yield name, "record", path, mutations
        fields = fields_of(record)
        name = f"records/{content} uncompressed.mat"
        path = _place(folder, name, "a.mat")
        lists = {k: np.array(v, dtype=object) if isinstance(v, tuple) else v for k, v in fields.items()}
        scipy.io.savemat(path, lists, oned_as="column")
        yield name, "record", path, BINARY
        name = f"records/{content} 7.3.mat"
        path = _place(folder, name, "a.mat")
        _save_73(path, fields)
        yield name, "record", path, BINARY
    name = "records/history text.uff"
    path = _place(folder, name, "a.uff")
    path.write_text(_text_uff())
    yield name, "record", path, TEXT
    name = "records/chunks.h5"
    path = _place(folder, name, "a.h5")
    write_record(path, _history())
    yield name, "chunks", path, BINARY
    name = "records/packed chunks.h5"
    path = _place(folder, name, "bare.h5")
    with h5py.File(path, "w") as file:
        file.create_dataset("all", data=_random(40, 3), chunks=(4, 2), compression="gzip", shuffle=True)
    yield name, "chunks", path, BINARY


def _tables(folder: Path) -> _Made:
    """Tables of laboratories, as `fuzz.targets.lab_table` reads them."""
    rows = [f"{i / 512:.6f};" + ";".join(f"{x:.4f}" for x in row) for i, row in enumerate(_random(12, 3))]
    text = "\n".join(["Zeit;A 1;A 2;Last", "s;g;g;N", *rows]).replace(".", ",") + "\n"
    for name, content in (("semicolons", text), ("commas", text.replace(",", ".").replace(";", ","))):
        path = _place(folder, f"records/lab {name}.csv", "a.csv")
        path.write_text(content)
        yield f"records/lab {name}.csv", "lab_table", path, TEXT


def _loggers(folder: Path) -> _Made:
    """Files of loggers whose library is installed."""
    for one in LOGGERS:
        name = f"records/logger{one.SUFFIXES[0]}"
        path = _place(folder, name, f"a{one.SUFFIXES[0]}")
        if find_spec(PACKAGES[one.kind].partition(".")[0]) is not None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                _WRITERS[one.kind](path)
            yield name, "logger", path, BINARY


def _write_tdms(path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    own = {"wf_increment": 0.1, "unit_string": "g"}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("test", f"A {j}", x, own) for j, x in enumerate(_random(3, 24))])


def _write_mdf(path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(x, np.arange(24) / 10, name=f"A {j}", unit="g") for j, x in enumerate(_random(3, 24))])
        file.save(path, overwrite=True)


def _write_miniseed(path: Path) -> None:
    import obspy

    traces = [obspy.Trace(x.copy(), {"sampling_rate": 10.0, "channel": f"HN{j}"}) for j, x in enumerate(_random(3, 24))]
    obspy.Stream(traces).write(str(path), format="MSEED", reclen=512)


def _write_lvm(path: Path) -> None:
    head = "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tNo\n***End_of_Header***\n"
    own = "Channels\t3\nSamples\t24\t24\t24\nY_Unit_Label\tg\tg\tg\n"
    own += "X_Dimension\tTime\tTime\tTime\nX0\t0\t0\t0\nDelta_X\t0.1\t0.1\t0.1\n"
    rows = ["\t".join(["", *map(str, row)]) for row in _random(24, 3).tolist()]
    path.write_text(f"{head}{own}***End_of_Header***\nX_Value\tA 0\tA 1\tA 2\tComment\n" + "\n".join(rows) + "\n")


def _write_wav(path: Path) -> None:
    scipy.io.wavfile.write(path, 10, _random(24, 3))


def _write_parquet(path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    columns = {"time [s]": np.arange(24) / 10, **{f"A {j}": x.copy() for j, x in enumerate(_random(3, 24))}}
    parquet.write_table(pyarrow.table(columns), str(path))


_WRITERS: dict[str, Callable[[Path], None]] = {
    "tdms": _write_tdms, "mdf": _write_mdf, "miniseed": _write_miniseed, "lvm": _write_lvm, "wav": _write_wav,
    "parquet": _write_parquet,
}  # fmt: skip


def _save_73(path: Path, fields: dict) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:

        def characters(name: str, text: str):  # type: ignore[no-untyped-def]
            file[name] = np.frombuffer(text.encode("utf-16-le") or b" \0", dtype="u2")[:, None]
            file[name].attrs["MATLAB_class"] = np.bytes_("char")
            return file[name].ref

        for name, field in fields.items():
            if isinstance(field, str):
                characters(name, field)
            elif isinstance(field, tuple):
                cells = [characters(f"#refs#/{name}{i}", text) for i, text in enumerate(field)]
                file.create_dataset(name, data=np.array([cells], dtype=object), dtype=h5py.ref_dtype)
                file[name].attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                file[name] = field.T


def _text_uff() -> str:
    numbers = f"{1:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10s}{1:10d}{1:4d} {'NONE':<10s}{0:10d}{0:4d}"
    form = f"{2:10d}{12:10d}{1:10d}{0.0:13.5e}{0.1:13.5e}{0.0:13.5e}"
    return _dataset_58("structid", (numbers, form), (17, "s"), (12, "m/s^2"), _random(12))


def _dataset_58(
    note: str,
    records: tuple[str, str],
    abscissa: tuple[int, str],
    ordinate: tuple[int, str],
    values: np.ndarray,
) -> str:
    """A function in text, dataset 58: its records 6 and 7, type and unit of both axes, and its numbers, six a line."""
    head = ["    -1", "    58", note, "NONE", "NONE", "NONE", "NONE", *records]
    for code, unit in (abscissa, ordinate, (0, "NONE"), (0, "NONE")):
        head.append(f"{code:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {unit:<20s}")
    rows = ["".join(f"{x:13.5e}" for x in values[k : k + 6]) for k in range(0, len(values), 6)]
    return "\n".join([*head, *rows, "    -1", ""])


def _bare(folder: Path) -> _Made:
    path = _place(folder, "bare/history.npy", "a.npy")
    np.save(path, _random(24, 3))
    yield "bare/history.npy", "bare_history", path, BINARY
    path = _place(folder, "bare/chunks.npy", "a.npy")
    np.save(path, np.asfortranarray(_random(24, 3)))
    yield "bare/chunks.npy", "chunks", path, BINARY
    arrays = {"h": _random(9, 2) + 1j * _random(9, 2), "f": np.arange(1.0, 10)}
    path = _place(folder, "bare/frf.npz", "a.npz")
    np.savez(path, **arrays)
    yield "bare/frf.npz", "bare_frf", path, ARCHIVE
    path = _place(folder, "bare/frf.mat", "a.mat")
    scipy.io.savemat(path, {**arrays, "note": "text", "s": {"a": 1.0, "b": [1, 2]}})
    yield "bare/frf.mat", "bare_frf", path, BINARY
    path = _place(folder, "bare/frf 4.mat", "a.mat")
    scipy.io.savemat(path, {**arrays, "note": "text"}, format="4")
    yield "bare/frf 4.mat", "bare_frf", path, BINARY
    path = _place(folder, "bare/frf.h5", "a.h5")
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[name] = array
    yield "bare/frf.h5", "bare_frf", path, BINARY


def _matrix() -> ImportedMatrix:
    square = np.array([[4.0, -2, 0, 0], [-2, 5, -1.5, 0], [0, -1.5, 1234.5, 1], [0, 0, 1, 2]])
    dofs = np.array([[1, 1], [1, 2], [2, 1], [12, 4]])
    row, column = np.nonzero(square)
    entries = ElementEntries(np.full(len(row), 7), row, column, square[row, column])
    return ImportedMatrix("K", sparse.csc_array(square), dofs, elements=entries)


USER_ELEMENTS = """\
** ELEMENT NUMBER           11 STEP NUMBER            2 INCREMENT NUMBER            1
*USER ELEMENT, NODES=            2, LINEAR
** ELEMENT NODES
**          101,         102
1, 2
2, 1
*MATRIX,TYPE=STIFFNESS
 4.00000000000000    ,
 1.0 , 5.0D+00
 0.0 , 2.0, 6.0
*Matrix, type=mass
1., 0., 1., 0., 0., 1.
"""


def _matrices(folder: Path) -> _Made:
    item = _matrix()
    for layout in ("bigmat", "sparse", "dense"):
        for binary in (True, False):
            name = f"matrices/{layout} {'binary' if binary else 'text'}.op4"
            path = _place(folder, name, "a.op4")
            write_op4(path, [item, ImportedMatrix("M", item.matrix)], Op4Options(binary, layout))  # type: ignore[arg-type]
            yield name, "matrices", path, BINARY if binary else TEXT
    for field in ("large", "small", "free"):
        path = _place(folder, f"matrices/{field}.pch", "a.pch")
        write_dmig(path, [item], field)  # type: ignore[arg-type]
        yield f"matrices/{field}.pch", "matrices", path, TEXT
    for form in ("labels", "coordinate", "elements"):
        path = _place(folder, f"matrices/{form}.mtx", "a.mtx")
        write_abaqus(path, item, form)  # type: ignore[arg-type]
        yield f"matrices/{form}.mtx", "matrices", path, TEXT
    path = _place(folder, "matrices/calculix.sti", "a.sti")
    path.write_text("1 1  2.0000000000000e+00\n1 2 -1.0000000000000e+00\n2 2  2.0000000000000e+00\n")
    path.with_suffix(".dof").write_text("1.1\n1.2\n")
    yield "matrices/calculix.sti", "matrices", path, TEXT
    path = _place(folder, "matrices/user.mtx", "a.mtx")
    path.write_text(USER_ELEMENTS)
    yield "matrices/user.mtx", "matrices", path, TEXT
    for suffix, mutations in ((".npz", ARCHIVE), (".npy", BINARY), (".mtx", TEXT)):
        path = _place(folder, f"matrices/scipy{suffix}", f"a{suffix}")
        write_matrix(path, item)
        yield f"matrices/scipy{suffix}", "matrices", path, mutations
    for form in ("csr", "coo", "dia"):
        path = _place(folder, f"matrices/{form}.npz", "a.npz")
        sparse.save_npz(path, item.matrix.asformat(form), compressed=False)
        yield f"matrices/{form}.npz", "matrices", path, ARCHIVE
    path = _place(folder, "matrices/array.mtx", "a.mtx")
    scipy.io.mmwrite(path, item.matrix.toarray())
    yield "matrices/array.mtx", "matrices", path, TEXT
    variables = {"K": item.matrix, "M": item.matrix.toarray(), "note": "text", "names": np.array(["a", "bc"], object)}
    for name, options in (("", {}), (" packed", {"do_compression": True}), (" 4", {"format": "4"})):
        path = _place(folder, f"matrices/variables{name}.mat", "a.mat")
        kept = {k: v for k, v in variables.items() if name != " 4" or k != "names"}
        scipy.io.savemat(path, kept, **options)
        yield f"matrices/variables{name}.mat", "matrices", path, COMPRESSED if "packed" in name else BINARY
    path = _place(folder, "matrices/boeing.rb", "a.rb")
    scipy.io.hb_write(path, sparse.csc_matrix(item.matrix))
    yield "matrices/boeing.rb", "matrices", path, TEXT


def _numberings(folder: Path) -> _Made:
    texts = {
        "names": "1X 1Y 2X,12RX\n3.01 # a comment\n",
        "pairs": "1 1\n1 2\n2 1\n12 4\n",
        "mapping": "  1  1  UX\n  2  1  UY\n  3  2  ROTX\n",
        "sets": "ASET    1       123     2       12\nASET1   12      3       THRU    6\nASET1,3,9,10\n",
        "extrn": "EXTRN   1       123     2       12\n",
    }
    for name, text in texts.items():
        path = _place(folder, f"numbering/{name}", "dofs.txt")
        path.write_text(text)
        yield f"numbering/{name}", "numbering", path, TEXT
    path = _place(folder, "geometry/table", "a.csv")
    path.write_text("node,x,y,z\n1,0,0,0\n2,0,0,3.5\n3,1,0,3.5\nline,1,2,3\n")
    yield "geometry/table", "geometry", path, TEXT
    path = _place(folder, "geometry/universal", "a.uff")
    _write_modes(path, Geometry({1: (0.0, 0, 0), 2: (0, 0, 1.0)}, ((1, 2),)))
    yield "geometry/universal", "geometry", path, TEXT


BULK = """SOL 101
CEND
BEGIN BULK
GRID     1               0.      0.      0.
GRID     2              1.       0.      0.
GRID*    3               2               1.              90.
*        0.
GRID,4,,0.,1.,0.
GRID     5               0.      0.     1.-0
CORD2C   2       0       0.      0.      0.      0.      0.      1.
         1.      0.      0.
CORD1R   3       1       2       4
$ Elements and Element Properties for region : cap
PSOLID   7       1       0
CPYRAM   2       7       1       2       3       4       5
CQUAD4   3       8       1       2       3       4
CBAR     13      1       1       5      0.     1.       0.
ENDDATA
"""
ABAQUS = """*Heading
*Part, name=Part-1
*Node, nset=all
      1,           0.,           0.
      2,           1.,           0.,   0.
      3,           1.,           1.
      4,           0.,           1.
*Element, type=S4R, elset=Skin
1, 1, 2, 3, 4
*Nset, nset=Set-1, generate
 1, 4, 1
*Elset, elset=Both
 Skin, 1
*End Part
*Assembly, name=Assembly
*Instance, name=Part-1-1, part=Part-1
          5.,           0.,           0.
          5.,           0.,           0.,           5.,           0.,           1.,          60.
*End Instance
*Nset, nset=Set-1, instance=Part-1-1
 1,  4
*End Assembly
"""


def _meshes(folder: Path) -> _Made:
    texts = {"a.bdf": BULK, "a.inp": ABAQUS, "a.unv": ANALYSIS, "offsets.bdf": OFFSET_BULK, "tied.inp": TIED}
    for name, text in texts.items():
        path = _place(folder, f"meshes/{name}", name)
        path.write_text(text)
        yield f"meshes/{name}", "mesh", path, TEXT
    path = _place(folder, "meshes/gmsh text.msh", "a.msh")
    shutil.copy(EXAMPLES / "plate_from_mesh" / "plate.msh", path)
    yield "meshes/gmsh text.msh", "mesh", path, TEXT
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]])
    cells = [("quad", np.array([[0, 1, 2, 3]])), ("triangle", np.array([[1, 4, 2]]))]
    tags = {"gmsh:physical": [np.array([1]), np.array([2])], "gmsh:geometrical": [np.array([1]), np.array([1])]}
    given = meshio.Mesh(points, cells, cell_data=tags)
    writers: dict[str, tuple[str, Callable[[Path], None], tuple[Mutation, ...]]] = {
        "gmsh 2.2 binary.msh": ("a.msh", lambda p: meshio.write(p, given, "gmsh22"), BINARY),
        "gmsh 2.2 text.msh": ("a.msh", lambda p: meshio.write(p, given, "gmsh22", binary=False), TEXT),
        "gmsh 4.1 binary.msh": ("a.msh", _binary_gmsh, BINARY),
        "vtk binary.vtk": ("a.vtk", lambda p: meshio.write(p, given, "vtk"), BINARY),
        "vtk text.vtk": ("a.vtk", lambda p: meshio.write(p, given, "vtk", binary=False), TEXT),
        "vtu packed.vtu": ("a.vtu", lambda p: meshio.write(p, given, "vtu"), (*TEXT, *BINARY)),
        "vtu text.vtu": ("a.vtu", lambda p: meshio.write(p, given, "vtu", binary=False), TEXT),
    }
    for name, (file, write, mutations) in writers.items():
        path = _place(folder, f"meshes/{name}", file)
        write(path)
        yield f"meshes/{name}", "mesh", path, mutations


def _binary_gmsh(path: Path) -> None:
    """Two triangles and an edge of a square, nodes 7 5 3 1, as Gmsh writes bytes."""
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    head = b'$MeshFormat\n4.1 1 8\n\1\0\0\0\n$EndMeshFormat\n$PhysicalNames\n1\n2 9 "the skin"\n$EndPhysicalNames\n'
    box = struct.pack("<6d", 0, 0, 0, 1, 1, 0)
    entities = struct.pack("<4Q", 0, 0, 1, 0) + struct.pack("<i", 1) + box + struct.pack("<QiQ", 1, 9, 0)
    nodes = struct.pack("<4Q", 1, 4, 1, 7) + struct.pack("<3iQ4Q", 2, 1, 0, 4, 7, 5, 3, 1)
    nodes += b"".join(struct.pack("<3d", *point) for point in points)
    cells = struct.pack("<4Q", 1, 2, 2, 3) + struct.pack("<3iQ8Q", 2, 1, 2, 2, 2, 7, 5, 3, 3, 7, 3, 1)
    sections = ((b"Entities", entities), (b"Nodes", nodes), (b"Elements", cells))
    path.write_bytes(head + b"".join(b"$%s\n%s\n$End%s\n" % (name, body, name) for name, body in sections))


def _write_modes(path: Path, geometry: Geometry | None = None) -> None:
    shapes = np.array([[1.0, 0.5], [0.5, -1.0]])
    modes = ModalRecord(
        np.array([2.0, 5.0]), np.array([0.01, 0.02]), shapes, ("1X", "2X"), covariance=np.diag([1e-4, 2e-4, 1e-6, 2e-6])
    )
    write_modes(path, modes, geometry)


def _modes(folder: Path) -> _Made:
    for suffix in (".json", ".csv", ".uff"):
        path = _place(folder, f"modes/modes{suffix}", f"a{suffix}")
        _write_modes(path)
        yield f"modes/modes{suffix}", "modes", path, TEXT
    texts = {"modes.f06": LISTING, "modes.pch": PUNCHED, "modes.frd": RESULTS, "analysis data.unv": ANALYSIS}
    texts |= {"complex.f06": COMPLEX_LISTING}
    for name, text in texts.items():
        path = _place(folder, f"modes/{name}", f"a{Path(name).suffix}")
        path.write_text(text)
        yield f"modes/{name}", "modes", path, TEXT

    path = _place(folder, "modes/modes.op2", "a.op2")
    path.write_bytes(_results_of_nastran())
    yield "modes/modes.op2", "modes", path, BINARY


def _results_of_nastran() -> bytes:
    """A binary file of one real mode of two points."""

    def record(*words: int | float | bytes) -> bytes:
        parts = [w if isinstance(w, bytes) else struct.pack("<f" if isinstance(w, float) else "<i", w) for w in words]
        data = b"".join(parts)
        return struct.pack("<i", len(data)) + data + struct.pack("<i", len(data))

    heading = [21, 7, 0, 1, 1, 100.0, 0.0, 0, 1, 8, *[0] * 136]
    rows = [11, 1, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 21, 1, -0.5, 0.25, 0.0, 0.0, 0.0, 0.0]
    content = record(2) + record(b"OUGV1   ") + record(-1) + record(7) + record(101, 0, 0, 0, 0, 0, 0)
    content += record(-2) + record(1) + record(0) + record(2) + record(b"OUGV1   ")
    for number, part in ((-3, heading), (-4, rows)):
        content += record(number) + record(1) + record(0) + record(len(part)) + record(*part)
    return content + record(-5) + record(1) + record(0) + record(0) + record(0)


def _spectra(folder: Path) -> _Made:
    path = _place(folder, "spectra/spectra.unv", "a.unv")
    text = ""
    for i, j, kind in ((1, 1, 2), (2, 1, 3), (2, 2, 2)):
        numbers = f"{kind:5d}{0:10d}{1:5d}{0:10d} {'NONE':<10s}{i:10d}{1:4d} {'NONE':<10s}{j:10d}{1:4d}"
        form = f"{5:10d}{12:10d}{1:10d}{1.0:13.5e}{0.5:13.5e}{0.0:13.5e}"
        size = 1 / (1 + (np.arange(12.0) - 6) ** 2)
        pairs = np.stack([size, 0.1 * size * (i != j)], axis=1).ravel()
        text += _dataset_58("averages: 9", (numbers, form), (18, "Hz"), (12, "g^2/Hz"), pairs)
    path.write_text(text)
    yield "spectra/spectra.unv", "spectrum", path, TEXT
    path = _place(folder, "spectra/spectra.npz", "a.npz")
    peak = 1 / (1 + (np.arange(12.0) - 6) ** 2)
    np.savez(path, s=peak[:, None, None] * np.array([[1.0], [0.5 + 0.1j]]), f=np.arange(1.0, 13))
    yield "spectra/spectra.npz", "spectrum", path, ARCHIVE
    path = _place(folder, "spectra/correlations.unv", "a.unv")
    text, lag = "", np.arange(40.0)
    for i, kind in ((1, 7), (2, 8)):
        numbers = f"{kind:5d}{0:10d}{1:5d}{0:10d} {'NONE':<10s}{i:10d}{1:4d} {'NONE':<10s}{1:10d}{1:4d}"
        form = f"{2:10d}{40:10d}{1:10d}{0.0:13.5e}{0.1:13.5e}{0.0:13.5e}"
        values = np.exp(-0.05 * lag) * np.cos(0.7 * lag) / i
        text += _dataset_58("averages: 9", (numbers, form), (17, "s"), (12, "g^2"), values)
    path.write_text(text)
    yield "spectra/correlations.unv", "correlation", path, TEXT


def _studies(folder: Path) -> _Made:
    for name in ("three_storey_frame", "ambient_storeys", "plate_from_mesh"):
        path = folder / f"study_{name}" / "study.toml"
        shutil.copytree(EXAMPLES / name, path.parent)
        yield f"study/{name}", "study", path, STUDY
    path = _place(folder, "study/chain", "study.toml")
    write_chain(path)
    yield "study/chain", "study", path, STUDY
    path = _place(folder, "study/matrices", "study.toml")
    path.write_text(MATRICES)
    item = _matrix()
    write_matrix(path.parent / "k.npz", item)
    write_matrix(path.parent / "m.mtx", ImportedMatrix("M", sparse.csc_array(np.diag([1.0, 2, 3, 4]))))
    (path.parent / "dofs.txt").write_text("1X 1Y 2X 12X\n")
    write_record(path.parent / "frf.npz", _frf())
    yield "study/matrices", "study", path, STUDY


def write_chain(path: Path, text: str | None = None) -> None:
    """The study of a chain of masses, with its record beside it: the chain's own answer and some noise."""
    path.write_text(text or CHAIN)
    frequency = np.linspace(0.5, 12, 60)
    omega = 2 * np.pi * frequency[:, None, None]
    stiffness = np.array([[2200.0, -1000, 0], [-1000, 2000, -1000], [0, -1000, 1000]]) * (1 + 0.02j)
    dynamic = -(omega**2) * np.diag([2.0, 3.0, 1.0]) + 1j * omega * np.diag([3.0, 0, 0]) + stiffness
    values = -(omega**2) * np.linalg.inv(dynamic)[:, [0, 2], :][:, :, [2]]
    noisy = values * (1 + 0.01 * _random(60, 2, 1))
    write_record(path.parent / "frf.npz", FrfRecord(frequency, noisy, ("1X", "3X"), ("3X",), "accelerance"))


CHAIN = """\
title = "Chain of three masses"
[structure]
active = ["X"]
[structure.nodes]
1 = 0.0
2 = 1.0
3 = 2.0
[[structure.point_mass]]
name = "masses"
nodes = [1, 2, 3]
mass = [2.4, 2.4, 1.2]
[[structure.spring]]
name = "ground"
first = "1X"
stiffness = 1200.0
loss_factor = 0.03
[[structure.spring]]
name = "upper"
first = ["1X", "2X"]
second = ["2X", "3X"]
stiffness = 900.0
loss_factor = 0.03
[[structure.dashpot]]
name = "damper"
first = "1X"
viscous_damping = 2.0
[[unknown]]
property = "mass"
elements = "masses"
each = true
prior = { mean = 2.0, std = 0.5 }
[[unknown]]
property = "stiffness"
elements = "upper"
each = true
bounds = [10.0, 1e6]
[[unknown]]
property = "loss_factor"
elements = ["ground", "upper"]
name = "springs"
[[regularization]]
kind = "smoothness"
property = "stiffness"
elements = "upper"
strength = 4.0
[record]
path = "frf.npz"
[record.noise]
relative = 0.01
[method]
band = [0.5, 12.0]
restarts = 1
seed = 3
"""
MATRICES = """\
title = "Matrices"
[structure.matrices]
dofs = "dofs.txt"
length_unit = "mm"
force_unit = "N"
[[structure.matrix_group]]
name = "all"
mass = "m.mtx"
stiffness = { path = "k.npz", matrix = "K" }
loss_factor = 0.02
indefinite = true
[[unknown]]
property = "stiffness"
elements = "all"
[record]
path = "frf.npz"
outputs = ["1X"]
[record.noise]
relative = 0.01
[method]
band = [1.0, 9.0]
"""


def _kept(folder: Path) -> _Made:
    owner = {"layout": "structid checkpoint 2", "versions": {}, "inputs": {"a": "b"}}
    for name, mutations in (("run.json", TEXT), ("done-00001.npz", ARCHIVE), ("search.npz", ARCHIVE)):
        path = _place(folder, f"checkpoint/{name}", name)
        kept = Checkpoint(path.parent, owner, seconds=0.0)
        kept.finished("search 1", {"theta": np.arange(3.0), "words": ["a", None, True]})
        kept.running("search 2", lambda: {"theta": np.arange(4.0), "cost": 2.0})
        kept.close()
        yield f"checkpoint/{name}", "checkpoint", path, mutations
    for name, mutations in (("estimate.json", TEXT), ("estimate.h5", BINARY)):
        path = _place(folder, f"results/{name}", name)
        _results(path.parent)
        yield f"results/{name}", "results", path, mutations


def _results(folder: Path) -> None:
    text = {
        "title": "t", "status": "converged", "covariance_basis": "noise", "provenance": {"inputs": {"a": "b"}},
        "regularization": [],
    }  # fmt: skip
    (folder / "estimate.json").write_text(json.dumps(text))
    (folder / "study.toml").write_text(CHAIN)
    with h5py.File(folder / "estimate.h5", "w") as file:
        for name in ("names", "kinds", "units"):
            file[f"parameters/{name}"] = np.array([b"mass[a]", b"kg"])
        file["parameters/values"], file["parameters/covariance_noise"] = np.ones(2), np.eye(2)
        file["frf/outputs"] = file["frf/inputs"] = np.array([b"1X+"])
        file["subdivide"] = 1
