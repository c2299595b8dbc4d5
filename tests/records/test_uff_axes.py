"""Sensors and loads of universal files whose nodes have axes of their own, uneven clocks, and functions chosen by number."""

import numpy as np
import pytest
from header_cases import Case, _form, _function, _Unit, dataset, fortran, rotation

from structid.core.errors import FileError, InputError
from structid.records import ReadOptions, read_record

N = 9


class Fixed:
    """Draws that leave the form of a file plain."""

    def random(self):
        return 0.99

    def choice(self, options):
        return options[0]


def function(output, load, values, axis=None, even=True, is_frf=True):
    case = Case(is_frf=is_frf)
    form = _form(case, Fixed())
    axis = 1.0 + np.arange(len(values)) if axis is None else axis
    head = (18, "Frequency", "Hz") if is_frf else (17, "Time", "s")
    kind = 4 if is_frf else 1
    below = _Unit("N", 1.0, [], 13) if is_frf else _Unit("", 1.0, [], 0)
    return _function(case, form, kind, output, load, values, axis, head, even, _Unit("m/s^2", 1.0, [], 12), below)


def axes_of(rows, *nodes):
    lines = ["".join(fortran(x, 25, 16) for x in row) for row in (*rows, (0.0, 0.0, 0.0))]
    systems = dataset(2420, f"{1:10d}", "part", f"{7:10d}{0:10d}{8:10d}", "CS", *lines)
    table = [
        line
        for node in nodes
        for line in (f"{node:10d}{0:10d}{7:10d}{11:10d}", "".join(fortran(float(node), 25, 16) for _ in range(3)))
    ]
    return systems + dataset(2411, *table)


@pytest.fixture
def rows():
    import random

    return rotation(random.Random(3), False)


def test_three_sensors_of_a_skewed_node_and_three_loads_are_turned_together(tmp_path, rng, rows):
    """The global response H = R' H_local R of a node with the axes R, with senses; another node stays as it is."""
    truth = rng.normal(size=(N, 3, 3)) + 1j * rng.normal(size=(N, 3, 3))
    local = np.einsum("ai,nij,bj->nab", rows, truth, rows)
    signs = (1, -1, 1)
    parts = [
        function((4, signs[a] * (a + 1)), (4, b + 1), signs[a] * local[:, a, b]) for a in (2, 0, 1) for b in range(3)
    ]
    path = tmp_path / "a.unv"
    path.write_bytes(axes_of(rows, 4) + b"".join(parts))
    record = read_record(path)
    assert [str(dof) for dof in (*record.outputs, *record.inputs)] == ["4X+", "4Y+", "4Z+"] * 2
    np.testing.assert_allclose(record.values, truth, atol=3e-5)
    assert "the three of node 4 are turned into global axes" in record.source


def test_a_lone_sensor_of_a_skewed_node_is_refused_with_its_direction(tmp_path, rng, rows):
    values = rng.normal(size=N) + 1j * rng.normal(size=N)
    path = tmp_path / "a.unv"
    path.write_bytes(axes_of(rows, 4) + function((4, 2), (9, 1), values))
    way = ", ".join(f"{x:.5g}" for x in rows[1])
    with pytest.raises(FileError) as caught:
        read_record(path)
    assert f'[record.sensors] "4Y" = {{ direction = [{way}] }}' in str(caught.value)
    assert "--axes named" in str(caught.value)
    record = read_record(path, ReadOptions(axes="named"))
    assert str(record.outputs[0]) == "4Y+"
    path.write_bytes(axes_of(rows, 9) + function((4, 2), (9, 1), values))
    with pytest.raises(FileError, match=r'9X\+ acts along .* "load 9X" = '):
        read_record(path)


def test_functions_of_frfs_are_chosen_and_called_by_number(tmp_path, rng):
    values = rng.normal(size=(3, N)) + 1j * rng.normal(size=(3, N))
    path = tmp_path / "a.unv"
    path.write_bytes(function((1, 0), (3, 1), values[0]) + function((2, 1), (3, 1), values[1]) * 2)
    with pytest.raises(FileError, match="function 1, at node 1, has direction 0"):
        read_record(path)
    with pytest.raises(FileError, match=r"FRF of 2X\+/3X\+ twice, as functions 2 and 3"):
        read_record(path, ReadOptions(columns="2,3"))
    record = read_record(path, ReadOptions(columns="3,1", outputs="2Y,1Z-", inputs="3X"))
    assert [str(dof) for dof in record.outputs] == ["2Y+", "1Z-"]
    np.testing.assert_allclose(record.values[:, :, 0].T, values[[1, 0]], atol=3e-5)
    with pytest.raises(InputError, match="`outputs` must have 1 or 2 entries"):
        read_record(path, ReadOptions(columns="3,1", outputs="2Y,1Z,3X"))


def test_an_uneven_clock_is_resampled_on_request_and_says_what_it_costs(tmp_path, rng):
    """Steps that differ by 0.1 %: a sine of 3 Hz comes out as it is at the even times."""
    steps = 0.01 * (1 + 1e-3 * rng.uniform(-1, 1, 400))
    time = np.concatenate([[0.0], np.cumsum(steps)])
    path = tmp_path / "a.csv"
    path.write_text("time_s,1X [g]\n" + "".join(f"{t:.9f},{np.sin(6 * np.pi * t):.9f}\n" for t in time))
    with pytest.raises(
        FileError, match=r"time must be even.*`resample = .spline.`.*--resample spline on the command line"
    ):
        read_record(path)
    record = read_record(path, ReadOptions(resample="spline"))
    truth = np.sin(6 * np.pi * np.linspace(0, time[-1], 401))
    np.testing.assert_allclose(record.values[:, 0] / 9.80665, truth, atol=2e-6)
    assert record.sampling_rate == pytest.approx(400 / time[-1], rel=1e-9)
    assert "resampled: samples were up to" in record.source
    assert "% of a sine at 6.25 Hz" in record.source
    lost = np.delete(time, 50)
    path.write_text("time_s,1X [g]\n" + "".join(f"{t:.9f},0.5\n" for t in lost))
    with pytest.raises(FileError, match=r"cannot be resampled: sample 51 follows after 0\.02"):
        read_record(path, ReadOptions(resample="spline"))


def test_an_uneven_clock_of_a_universal_file(tmp_path, rng):
    time = 0.5 * (np.arange(40) + 0.02 * np.sin(np.arange(40)))
    path = tmp_path / "a.unv"
    path.write_bytes(function((1, 1), (0, 0), np.sin(0.3 * time), time, even=False, is_frf=False))
    with pytest.raises(FileError, match=r"sample times are not even.*--resample "):
        read_record(path)
    record = read_record(path, ReadOptions(resample="spline"))
    np.testing.assert_allclose(record.values[:, 0], np.sin(0.3 * record.time), atol=1e-4)
