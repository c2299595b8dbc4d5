"""Files of loggers, each written by its own library: the same channels under names of that program."""

import warnings
from collections.abc import Callable
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path

import numpy as np

RATE = 512.0
VALUES = np.random.default_rng(5).standard_normal((300, 3))
NAMES = ("Acc A", "Acc B", "Force")
UNITS = ("g", "m/s^2", "N")


def tdms(path: Path) -> None:
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

    clock = {"wf_increment": 1 / RATE, "wf_start_offset": 0.25, "wf_start_time": datetime(2026, 1, 1)}
    channels = [
        ChannelObject("Test", name, VALUES[:, j].copy(), properties={**clock, "unit_string": UNITS[j]})
        for j, name in enumerate(NAMES)
    ]
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([RootObject(), GroupObject("Test"), *channels])


def mdf(path: Path) -> None:
    from asammdf import MDF, Signal

    time = 0.25 + np.arange(len(VALUES)) / RATE
    file = MDF(version="4.10")
    file.append([Signal(VALUES[:, j].copy(), time, name=NAMES[j], unit=UNITS[j]) for j in range(3)])
    file.save(path, overwrite=True)
    file.close()


def miniseed(path: Path) -> None:
    import obspy

    header = {"network": "XX", "sampling_rate": RATE, "starttime": obspy.UTCDateTime(2026, 1, 1)}
    names = ("HNX", "HNY", "HNZ")
    traces = [obspy.Trace(VALUES[:, j].copy(), header={**header, "channel": names[j]}) for j in range(3)]
    obspy.Stream(traces).write(str(path), format="MSEED")


def lvm(path: Path) -> None:
    ends = "***End_of_Header***\n"
    file = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tNo\n"
    rows = {"Channels": [3], "Samples": [300] * 3, "Y_Unit_Label": UNITS, "X_Dimension": ["Time"] * 3, "X0": [0.25] * 3,
            "Delta_X": [1 / RATE] * 3}  # fmt: skip
    lines = ["\t".join(map(str, [key, *words])) for key, words in rows.items()]
    lines += [ends.strip(), "\t".join(["X_Value", *NAMES, "Comment"])]
    lines += ["\t".join(["", *(f"{x:.17g}" for x in row)]) for row in VALUES]
    path.write_text((file + ends + "\n".join(lines) + "\n").replace(".", ","))


def wav(path: Path) -> None:
    from scipy.io import wavfile

    wavfile.write(path, int(RATE), VALUES)


def parquet(path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet as file

    time = 0.25 + np.arange(len(VALUES)) / RATE
    columns = {"time [s]": time, **{f"{NAMES[j]} [{UNITS[j]}]": VALUES[:, j].copy() for j in range(3)}}
    file.write_table(pa.table(columns), str(path))


#: How a file of each kind is written; what it says of units and start.
WRITERS: dict[str, Callable[[Path], None]] = {w.__name__: w for w in (tdms, mdf, miniseed, lvm, wav, parquet)}
SAYS_UNITS = {"tdms", "mdf", "lvm", "parquet"}
STARTS = {"tdms": 0.25, "mdf": 0.25, "parquet": 0.25, "lvm": 0.25, "miniseed": 0.0, "wav": 0.0}
FILE_NAMES = {"miniseed": ("XX...HNX", "XX...HNY", "XX...HNZ"), "wav": ("1", "2", "3")}


def is_there(package: str) -> bool:
    """Whether the library of a format is installed."""
    return find_spec(package.partition(".")[0]) is not None


def write(kind: str, path: Path) -> None:
    """A file of this kind; what its library warns of on the way is its own matter."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        WRITERS[kind](path)
