"""What is written is what is read, for every format and any record."""

import dataclasses
import importlib
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError, InputError
from structid.records import FrfRecord, ReadOptions, TimeRecord, formats, read_record, write_record
from structid.records.formats import FORMATS

#: What each kind of file loses by its nature, as its documentation says.
LOST = {
    ".csv": {"variance", "averages", "noise_source", "source", "relative", "sizes"},
    ".uff": {"variance", "noise_source", "source", "relative", "sizes"},
}
LOST |= {".txt": LOST[".csv"], ".tsv": LOST[".csv"], ".unv": LOST[".uff"]}
#: Read only, or one of the forms of another suffix.
NOT_WRITTEN = {".npy", ".uf", ".ufb"}
WRITTEN = [suffix for module in FORMATS for suffix in module.SUFFIXES if suffix not in NOT_WRITTEN]
COMPLETE = [suffix for suffix in WRITTEN if suffix not in LOST]
FIRST = [module.SUFFIXES[0] for module in FORMATS if module.SUFFIXES[0] not in NOT_WRITTEN]

dofs = st.builds(Dof, st.integers(0, 999_999_999), st.sampled_from(DIRECTIONS), st.sampled_from((1, -1)))
numbers = st.floats(-1e12, 1e12, allow_subnormal=False)
parts = st.floats(0, 1, allow_subnormal=False)
texts = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=12)


@st.composite
def frf_records(draw):
    outputs = tuple(draw(st.lists(dofs, min_size=1, max_size=3, unique=True)))
    inputs = tuple(draw(st.lists(dofs, min_size=1, max_size=2, unique=True)))
    lines = draw(st.integers(1, 4))
    shape = (lines, len(outputs), len(inputs))
    steps = draw(arrays(float, lines, elements=st.sampled_from((0.25, 1.0, 1 / 3))))
    has = draw(st.tuples(*[st.booleans()] * 5))
    return FrfRecord(
        frequency=np.cumsum(steps) if lines > 1 else np.array([0.5]),
        values=draw(arrays(float, shape, elements=numbers)) + 1j * draw(arrays(float, shape, elements=numbers)),
        outputs=outputs,
        inputs=inputs,
        kind=draw(st.sampled_from(("receptance", "mobility", "accelerance"))),
        variance=draw(arrays(float, shape, elements=parts)) if has[0] else None,
        coherence=draw(arrays(float, shape, elements=parts)) if has[1] else None,
        averages=draw(st.integers(1, 10**6)) if has[2] else None,
        noise_source=draw(st.sampled_from(("coherence", "repeats", "declared", "unknown"))),
        source=draw(texts),
        relative=draw(arrays(float, shape, elements=parts)) if has[3] else None,
        sizes=draw(arrays(float, shape, elements=parts)) if has[4] else None,
    )


@st.composite
def time_records(draw):
    channels = tuple(draw(st.lists(dofs, min_size=1, max_size=3, unique=True)))
    quantities = draw(
        st.lists(
            st.sampled_from(("displacement", "velocity", "acceleration", "force")),
            min_size=len(channels),
            max_size=len(channels),
        )
    )
    samples = draw(st.integers(2, 6))
    return TimeRecord(
        sampling_rate=draw(st.sampled_from((1.0, 100.0, 1200.0, 3.0, 51200.0, 1 / 7))),
        values=draw(arrays(float, (samples, len(channels)), elements=numbers)),
        channels=channels,
        quantities=tuple(quantities),
        variance=draw(arrays(float, len(channels), elements=parts)) if draw(st.booleans()) else None,
        start=draw(st.sampled_from((0.0, 0.25, 1 / 3, -2.0))),
        source=draw(texts),
    )


def differences(first, second):
    """Names of the fields that are not the same to the last bit; 0 and -0 are one."""
    assert type(first) is type(second)
    names = []
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        both = isinstance(a, np.ndarray) and isinstance(b, np.ndarray)
        if not (
            (a + 0.0).tobytes() == (b + 0.0).tobytes() and a.shape == b.shape if both else type(a) is type(b) and a == b
        ):
            names.append(field.name)
    return set(names)


def through(suffix, record):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"record{suffix}"
        write_record(path, record)
        assert [entry.name for entry in Path(folder).iterdir()] == [path.name]
        return read_record(path)


@pytest.mark.parametrize("suffix", [suffix for suffix in FIRST if suffix not in LOST])
@settings(max_examples=40, deadline=None, derandomize=True)
@given(record=st.one_of(frf_records(), time_records()))
def test_complete_formats_keep_everything(suffix, record):
    assert differences(record, through(suffix, record)) == set()


def with_all_fields(frf, history):
    """The FRFs and the history with something in every field, whatever fields the classes will have."""
    sizes = np.abs(frf.values) / 3
    frf = dataclasses.replace(frf, decay=0.25 * np.arange(7), segment=2.0, relative=sizes / 100, sizes=sizes)
    for record in (frf, history):
        for field in dataclasses.fields(record):
            if field.default is not dataclasses.MISSING:
                value = getattr(record, field.name)
                assert isinstance(value, np.ndarray) or value != field.default, field.name
    return frf, history


@pytest.mark.parametrize("suffix", COMPLETE)
def test_complete_formats_forget_no_field(suffix, frf, history):
    for record in with_all_fields(frf, history):
        assert differences(record, through(suffix, record)) == set()


@pytest.mark.parametrize("suffix", [suffix for suffix in WRITTEN if suffix in LOST])
def test_partial_formats_forget_only_what_they_say_and_refuse_what_changes_the_meaning(tmp_path, suffix, frf, history):
    frf, history = with_all_fields(frf, history)
    for name in ("decay", "segment"):
        with pytest.raises(InputError, match=rf"cannot keep `{name}`, .*write \.npz, \.h5 or \.mat"):
            write_record(
                tmp_path / f"a{suffix}",
                dataclasses.replace(frf, **{"decay": None, "segment": None, name: getattr(frf, name)}),
            )
    assert not list(tmp_path.iterdir())
    frf = dataclasses.replace(frf, decay=None, segment=None)
    for record in (frf, history):
        assert differences(record, through(suffix, record)) <= LOST[suffix] | {"sampling_rate"}


@pytest.mark.parametrize("suffix", [suffix for suffix in FIRST if suffix in LOST])
@settings(max_examples=40, deadline=None, derandomize=True)
@given(record=st.one_of(frf_records(), time_records()))
def test_partial_formats_keep_the_measurement(suffix, record):
    back = through(suffix, record)
    changed = differences(record, back) - LOST[suffix]
    # the axis goes through a column of times or a step of six digits: rounding only
    assert changed <= {"frequency", "sampling_rate", "start", "coherence" if suffix == ".uff" else ""}
    if isinstance(record, FrfRecord):
        np.testing.assert_allclose(back.frequency, record.frequency, rtol=1e-13)
        if record.coherence is not None:
            np.testing.assert_array_equal(back.coherence, record.coherence)
        if suffix == ".csv" and record.variance is not None:
            np.testing.assert_allclose(back.variance, record.variance, rtol=1e-14)
    else:
        assert back.sampling_rate == pytest.approx(record.sampling_rate, rel=1e-11)
        assert back.start == pytest.approx(record.start, rel=1e-15)


@pytest.mark.parametrize("suffix", WRITTEN)
def test_negative_zero_does_not_stop_a_file(suffix):
    record = FrfRecord([0.5], np.full((1, 1, 1), complex(-0.0, 0.0)), ("1X",), ("1X",), "receptance")
    assert np.array_equal(through(suffix, record).values, record.values)


@pytest.mark.parametrize("suffix", WRITTEN)
def test_all_suffixes_keep_signs_and_rotations(suffix, frf, history):
    back = through(suffix, frf)
    assert [str(d) for d in back.outputs] == ["1X-", "2RZ+", "12Z-"]
    assert [str(d) for d in back.inputs] == ["3Z-", "4RX+"]
    assert differences(frf, back) == LOST.get(suffix, set()) - {"relative", "sizes"}
    assert differences(history, through(suffix, history)) <= {"variance", "source", "sampling_rate"} & (
        LOST.get(suffix, set()) | {"sampling_rate"}
    )


def test_suffix_of_no_format(tmp_path, frf):
    for call in (lambda p: read_record(p), lambda p: write_record(p, frf)):
        with pytest.raises(FileError, match=r"record\.docx: the suffix '\.docx' .*\.npz .*\.uff"):
            call(tmp_path / "record.docx")


def test_upper_case_suffix(tmp_path, frf):
    write_record(tmp_path / "A.NPZ", frf)
    assert read_record(str(tmp_path / "A.NPZ")).averages == 12


def test_npy_is_read_only(tmp_path, history):
    with pytest.raises(FileError, match=r"a\.npy: .*write \.npz"):
        write_record(tmp_path / "a.npy", history)


@pytest.mark.parametrize("suffix", [*COMPLETE, *(suffix for suffix in FIRST if suffix in LOST)])
def test_options_choose_channels(tmp_path, suffix, frf, history):
    path = tmp_path / f"f{suffix}"
    write_record(path, frf)
    part = read_record(path, ReadOptions(outputs="12Z-,1X-", inputs="4RX+"))
    np.testing.assert_array_equal(part.values, frf.values[:, [2, 0]][:, :, [1]])
    np.testing.assert_array_equal(part.coherence, frf.coherence[:, [2, 0]][:, :, [1]])
    with pytest.raises(InputError, match=r"asks for 9Z\+.*it has 1X-"):
        read_record(path, ReadOptions(outputs="9Z"))
    with pytest.raises(InputError, match="kind"):
        read_record(path, ReadOptions(kind="receptance"))
    write_record(path, history)
    part = read_record(path, ReadOptions(channels="2RZ+"))
    np.testing.assert_array_equal(part.values, history.values[:, [1]])
    assert read_record(path, ReadOptions(channels=["1X-"])).quantities == ("acceleration", "force")
    with pytest.raises(InputError, match=r"leave it out|leave the option out"):
        read_record(path, ReadOptions(sampling_rate=1000))


@pytest.mark.parametrize("suffix", COMPLETE)
def test_text_a_format_cannot_keep(tmp_path, suffix, history):
    with pytest.raises(InputError, match="plain text"):
        write_record(tmp_path / f"a{suffix}", dataclasses.replace(history, source="a\0b"))
    assert not list(tmp_path.iterdir())


NEW_FORMAT = '''
"""Records as JSON."""

import json

import numpy as np

from structid.core.errors import FileError
from structid.files import atomic_write
from structid.records.formats.layout import fields_of, record_from

SUFFIXES = (".mine",)


def read(path, options):
    try:
        stored = json.loads(path.read_text())
    except ValueError as error:
        raise FileError(f"{path}: is cut short") from error
    fields = {}
    for name, value in stored.items():
        complex_pair = isinstance(value, dict)
        fields[name] = np.array(value["re"]) + 1j * np.array(value["im"]) if complex_pair else value
        if isinstance(fields[name], list):
            fields[name] = np.array(value) if not isinstance(value[0], str) else tuple(value)
    return record_from(path, fields)


def write(path, record):
    stored = {}
    for name, value in fields_of(record).items():
        if isinstance(value, np.ndarray):
            value = {"re": value.real.tolist(), "im": value.imag.tolist()} if value.dtype.kind == "c" else value.tolist()
        stored[name] = list(value) if isinstance(value, tuple) else value
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(stored))
'''


def test_a_new_format_is_a_module_and_a_line_in_the_registry(tmp_path, monkeypatch, frf, history):
    (tmp_path / "mine.py").write_text(NEW_FORMAT)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(formats, "FORMATS", (*FORMATS, importlib.import_module("mine")))
    for record in (frf, history):
        assert differences(record, through(".mine", record)) == set()
    write_record(tmp_path / "a.mine", frf)
    (tmp_path / "a.mine").write_text("{")
    with pytest.raises(FileError, match=r"a\.mine: is cut short"):
        read_record(tmp_path / "a.mine")
    with pytest.raises(FileError, match=r"\.uff .*\.mine"):
        read_record(tmp_path / "a.docx")
