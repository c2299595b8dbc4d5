"""Internal forces and stresses against textbook statics and dynamics, differences of displacements, and the balance of energy."""

import numpy as np
import pytest

import structid as sid
from structid.core.errors import InputError
from structid.fem.elements.beam import hermite_mass, hermite_stiffness
from structid.prediction.identified_model import identified_model
from structid.prediction.recovery import parse_output

LENGTH, EI, EA, MASS = 2.0, 50.0, 4e4, 1.5
STATIC = [1e-3]


def model_of(structure, unknown=None, std=0.0):
    parameters = sid.parameters(
        structure, unknown or [sid.Unknown(structure.properties[1].term.property, structure.elements[0].name)]
    )
    return identified_model(structure, parameters, parameters.start, np.diag((std * parameters.start) ** 2))


def frf(structure, outputs, inputs, frequency=STATIC):
    found = sid.predict(model_of(structure), sid.Frf(outputs, inputs, frequency, "receptance"), n_draws=50)
    return found.values


def cantilever(n=4, subdivide=1, **options):
    beam = sid.Beam("beam", [[i, i + 1] for i in range(n)], mass=MASS, bending_stiffness=EI, **options)
    return sid.Structure({i: LENGTH * i / n for i in range(n + 1)}, [beam], fixed=("0Y", "0RZ"), subdivide=subdivide)


def test_a_cantilever_under_a_force_at_its_tip():
    moments = frf(cantilever(), ["M[beam:1@0]", "M[beam:1@1]", "M[beam:2@1]", "M[beam:4@4]"], ["4Y"])[0, :, 0].real
    assert moments == pytest.approx([2.0, 1.5, 1.5, 0.0], abs=1e-4)
    assert frf(cantilever(), ["V[beam:1@0]", "V[beam:4@4]"], ["4Y"])[0, :, 0].real == pytest.approx(
        [1.0, 1.0], abs=1e-4
    )
    stress = frf(cantilever(), ["stress[beam:1@0 y=0.05 E=2e11]"], ["4Y"])[0, 0, 0].real
    assert stress == pytest.approx(-2e11 * 0.05 * 2.0 / EI, rel=1e-4)


def test_a_beam_turned_in_the_plane_has_axial_force_too():
    turn = np.radians(30)
    along = np.array([np.cos(turn), np.sin(turn)])
    beam = sid.Beam("beam", [[0, 1], [1, 2]], mass=MASS, bending_stiffness=EI, axial_stiffness=EA)
    structure = sid.Structure({i: i * along for i in range(3)}, [beam], fixed=("0X", "0Y", "0RZ"))
    for name, expected in (("N", (along[0], along[1])), ("V", (-along[1], along[0]))):
        assert frf(structure, [f"{name}[beam:2@1]"], ["2X", "2Y"])[0, 0].real == pytest.approx(expected, abs=1e-4)
    moment = frf(structure, ["M[beam:1@0]"], ["2X", "2Y"])[0, 0].real
    assert moment == pytest.approx([-2 * along[1], 2 * along[0]], abs=1e-3)
    strain = frf(structure, ["strain[beam:1@0 y=-0.1]"], ["2X"])[0, 0, 0].real
    assert strain == pytest.approx(along[0] / EA + 0.1 * moment[0] / EI, abs=1e-6)


def test_a_beam_in_space_about_its_own_axes():
    """A right angle in space: force Z at the end of the second beam twists the first."""
    sections = {
        "bending_stiffness_y": 80.0,
        "bending_stiffness_z": EI,
        "axial_stiffness": EA,
        "torsional_stiffness": 30.0,
    }
    beam = sid.SpaceBeam("beam", [[0, 1], [1, 2]], mass=MASS, polar_inertia=0.01, orientation=[0, 0, 1.0], **sections)
    nodes = {0: (0.0, 0, 0), 1: (2.0, 0, 0), 2: (2.0, 1.0, 0)}
    structure = sid.Structure(nodes, [beam], fixed=[f"0{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")])
    # local y is Z and local z is -Y of the first beam; about its own axes a force along Z bends it by MZ
    read = [f"{name}[beam:1@0]" for name in ("T", "MY", "MZ")]
    assert frf(structure, read, ["2Z"])[0, :, 0].real == pytest.approx([1.0, 0.0, 2.0], abs=1e-3)
    read = [f"{name}[beam:1@0]" for name in ("N", "VY", "VZ")]
    assert frf(structure, read, ["2X", "2Y", "2Z"])[0].real == pytest.approx(
        np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]), abs=1e-3
    )
    strain = frf(structure, ["strain[beam:1@0 y=0.02 z=0.03]"], ["2Y"])[0, 0, 0].real
    # a force along Y at x = 2 bends the first beam by 2 at its foot, so that fibres at +Y are pressed; z = 0.03 is Y = -0.03
    assert strain == pytest.approx(2.0 * 0.03 / 80.0, rel=1e-3)


@pytest.mark.parametrize("subdivide", [1, 5])
def test_a_simply_supported_beam_under_a_harmonic_force_at_its_middle(subdivide):
    """Euler and Bernoulli: M = -P / 4b (sin bx / cos(bL/2) + sinh bx / cosh(bL/2)), with b^4 = m w^2 / EI."""
    n = 10
    beam = sid.Beam("beam", [[i, i + 1] for i in range(n)], mass=MASS, bending_stiffness=EI)
    structure = sid.Structure(
        {i: LENGTH * i / n for i in range(n + 1)}, [beam], fixed=("0Y", f"{n}Y"), subdivide=subdivide
    )
    frequency = np.array([1.0, 3.0, 9.0])
    found = frf(structure, ["M[beam:2@2]", "M[beam:5@5]"], ["5Y"], frequency)[:, :, 0].real
    b = (MASS * (2 * np.pi * frequency) ** 2 / EI) ** 0.25
    x, half = np.array([0.4, 1.0]), LENGTH / 2
    exact = -(np.sin(np.outer(b, x)) / np.cos(b * half)[:, None] + np.sinh(np.outer(b, x)) / np.cosh(b * half)[:, None])
    assert found == pytest.approx(exact / (4 * b[:, None]), rel=2e-4)


def test_the_strain_of_a_fibre_is_the_difference_of_rotations():
    n, h = 40, LENGTH / 40
    frequency = np.array([1.0, 2.0])
    found = frf(cantilever(n), ["strain[beam:11@10 y=0.1]"], ["40Y"], frequency)[:, 0, 0]
    turned = frf(cantilever(n), ["9RZ", "11RZ"], ["40Y"], frequency)[:, :, 0]
    assert found == pytest.approx(-0.1 * (turned[:, 1] - turned[:, 0]) / (2 * h), rel=1e-3)


def test_forces_at_a_node_are_in_balance_and_their_work_is_the_energy_of_the_part_behind():
    structure = cantilever(6, stiffness_damping=0.05)
    rate, n = 2000.0, 1200
    push = np.where(np.arange(n) < 200, np.sin(np.pi * np.arange(n) / 200), 0.0)[:, None]
    model = model_of(structure)

    def history(outputs, motion="displacement"):
        return sid.predict(model, sid.History(outputs, ["6Y"], push, rate, motion), n_draws=50).values

    moment, other = history(["M[beam:3@3]", "M[beam:4@3]"]).T
    assert moment == pytest.approx(other, abs=1e-6 * np.abs(moment).max())
    shear = history(["V[beam:4@3]"])[:, 0]
    speed = history(["3Y", "3RZ", "6Y"], "velocity").T
    work = np.concatenate([[0], np.cumsum(np.diff(np.arange(n)) / rate * np.convolve(
        push[:, 0] * speed[2] - shear * speed[0] - moment * speed[1], [0.5, 0.5], "valid"))])  # fmt: skip
    behind = sid.Structure({i: LENGTH * i / 6 for i in range(3, 7)}, [
        sid.Beam("beam", [[i, i + 1] for i in range(3, 6)], mass=MASS, bending_stiffness=EI, stiffness_damping=0.05)])  # fmt: skip
    outputs = [str(dof) for dof in behind.dofs]
    u, v = history(outputs), history(outputs, "velocity")
    m, k, c = (behind.matrix(kind).toarray() for kind in ("mass", "stiffness", "damping"))
    energy = 0.5 * np.einsum("ti,ij,tj->t", v, m, v) + 0.5 * np.einsum("ti,ij,tj->t", u, k, u)
    lost = np.einsum("ti,ij,tj->t", v, c, v)
    lost = np.concatenate([[0], np.cumsum(np.convolve(lost, [0.5, 0.5], "valid")) / rate])
    assert energy + lost == pytest.approx(work, abs=2e-3 * energy.max())
    assert lost[-1] > 0.02 * energy.max()


def test_a_plate_strip_bends_as_a_beam():
    """Cylindrical bending without Poisson's ratio: stress = 6 F (L - x) / (b t^2) at the top and bottom."""
    n, width, thick = 6, 0.3, 0.01
    nodes = {10 * i + j: (0.1 * i, width * j) for i in range(n + 1) for j in range(2)}
    cells = [[10 * i, 10 * i + 10, 10 * i + 11, 10 * i + 1] for i in range(n)]
    plate = sid.Plate("plate", cells, youngs_modulus=7e10, density=2700.0, thickness=thick, poisson=0.0)
    fixed = [f"{node}{d}" for node in (0, 1) for d in ("Z", "RX", "RY")]
    structure = sid.Structure(nodes, [plate], fixed=fixed, active=["Z", "RX", "RY"])
    stress = frf(
        structure, ["stress_xx[plate:2@top]", "stress_xx[plate:2@bottom]", "stress_yy[plate:2@top]"], ["60Z", "61Z"]
    )
    bent = 6 * (0.6 - 0.15) / (width * thick**2)
    both = stress[0].sum(axis=1).real / 2
    assert both == pytest.approx([-bent, bent, 0.0], rel=1e-3, abs=1e-3 * bent)


def test_a_tilted_shell_is_stretched_and_bent_in_its_own_plane():
    """A strip along a slope in space: a force along it stretches, a force across it bends; von Mises as of one axis."""
    n, width, thick, slope = 6, 0.3, 0.01, np.radians(35)
    along, across, normal = (
        np.array([np.cos(slope), 0, np.sin(slope)]),
        np.array([0, 1.0, 0]),
        np.array([-np.sin(slope), 0, np.cos(slope)]),
    )
    nodes = {10 * i + j: 0.1 * i * along + width * j * across for i in range(n + 1) for j in range(2)}
    cells = [[10 * i, 10 * i + 10, 10 * i + 11, 10 * i + 1] for i in range(n)]
    shell = sid.Shell("shell", cells, youngs_modulus=7e10, density=2700.0, thickness=thick, poisson=0.0)
    directions = ("X", "Y", "Z", "RX", "RY", "RZ")
    structure = sid.Structure(nodes, [shell], fixed=[f"{node}{d}" for node in (0, 1) for d in directions])
    read = [f"stress_xx[shell:3@{place}]" for place in ("top", "middle", "bottom")]
    loads = [f"{node}{d}" for node in (60, 61) for d in ("X", "Z")]
    stress = (
        frf(structure, read, loads)[0].real.reshape(3, 2, 2).sum(axis=1) / 2
    )  # per force X and Z, spread over the end
    bent = 6 * (0.6 - 0.25) / (width * thick**2)
    for force in (along, normal):
        stretched = force @ along / (width * thick)
        expected = stretched + bent * (force @ normal) * np.array([-1, 0, 1])
        assert stress @ force[[0, 2]] == pytest.approx(expected, rel=2e-3, abs=2e-3 * bent)
    push = np.sin(np.pi * np.arange(200) / 200)[:, None] ** 4 * np.array([1.0, 2.0, 3.0, 4.0])
    model = model_of(structure)
    mises, xx, yy, xy = (
        sid.predict(model, sid.History([f"{name}[shell:3@top]"], loads, push, 200.0), n_draws=50).values[:, 0]
        for name in ("von_mises", "stress_xx", "stress_yy", "stress_xy")
    )
    assert mises == pytest.approx(np.sqrt(xx**2 - xx * yy + yy**2 + 3 * xy**2), rel=1e-3, abs=1e-3 * mises.max())


def test_the_band_of_a_stress_follows_the_parameters():
    """Static moment has no error; the strain goes with 1 / EI, the stress of a given section too."""
    structure = cantilever()
    model = model_of(structure, [sid.Unknown("bending_stiffness", "beam")], 0.05)
    moment, strain = (
        sid.predict(model, sid.Frf([name], ["4Y"], STATIC), n_draws=400)
        for name in ("M[beam:1@0]", "strain[beam:1@0 y=0.05]")
    )
    assert moment.std[0, 0, 0] < 1e-5 * 2.0
    assert strain.std[0, 0, 0] == pytest.approx(0.05 * abs(strain.values[0, 0, 0]), rel=0.12)


def test_large_models_are_read_by_their_element_matrices():
    n = 40
    structure, frequency = cantilever(n), np.linspace(1, 40, 30)
    model = model_of(structure, [sid.Unknown("bending_stiffness", "beam")], 0.02)
    found = sid.predict(model, sid.Frf(["M[beam:21@20]"], ["40Y"], frequency), n_draws=50)
    k, m = (structure.matrix(kind).toarray() for kind in ("stiffness", "mass"))
    h = np.array([LENGTH / n])
    rows = [[str(dof) for dof in structure.dofs].index(f"{node}{d}+") for node in (20, 21) for d in ("Y", "RZ")]
    tip = np.array([str(dof) == "40Y+" for dof in structure.dofs], dtype=float)
    exact = []
    for w in 2 * np.pi * frequency:
        local = EI * hermite_stiffness(h)[0] - w**2 * MASS * hermite_mass(h)[0]
        exact.append(-local[1] @ np.linalg.solve(k - w**2 * m, tip)[rows])
    assert found.values[:, 0, 0] == pytest.approx(np.array(exact), rel=1e-6)
    assert np.all(found.low <= np.abs(found.values))
    assert np.all(found.high >= np.abs(found.values))


def test_spectrum_of_von_mises_is_that_of_its_square():
    nodes = {0: (0, 0), 1: (0.2, 0), 2: (0.2, 0.2), 3: (0, 0.2)}
    plate = sid.Plate("p", [[0, 1, 2, 3]], youngs_modulus=7e10, density=2700.0, thickness=0.005, poisson=0.3)
    structure = sid.Structure(nodes, [plate], fixed=("0Z", "0RX", "0RY", "3Z", "3RX", "3RY"), active=["Z", "RX", "RY"])
    frequency = np.array([5.0, 20.0])
    density = np.array([[2.0], [3.0]])
    of = {}
    for name in ("von_mises", "stress_xx", "stress_yy", "stress_xy"):
        quantity = sid.Frf([f"{name}[p:1@top]"], ["1Z"], frequency)
        of[name] = sid.predict(model_of(structure), sid.Spectrum(quantity, density), n_draws=50).values[:, 0]
    xx, yy = (frf(structure, [f"stress_{d}[p:1@top]"], ["1Z"], frequency)[:, 0, 0] for d in ("xx", "yy"))
    cross = (xx * np.conj(yy)).real * density[:, 0]
    assert of["von_mises"] == pytest.approx(of["stress_xx"] + of["stress_yy"] - cross + 3 * of["stress_xy"])
    with pytest.raises(InputError, match="has no FRF: it is not linear"):
        frf(structure, ["von_mises[p:1@top]"], ["1Z"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("M[beam:9@0]", "has elements 1 to 4, got 9"),
        ("M[beem:1@0]", "nearest is 'beam'"),
        ("M[beam@1]", "elements 1 to 4; write the number of the one, such as M.beam:1@1"),
        ("M[beam:1@3]", "runs from node 0 to 1, got 3"),
        ("N[beam:1@0]", "have V, M, not N"),
        ("stress[beam:1@0 z=0.1 E=1e9]", "bend along y alone"),
        ("stress[beam:1@0 y=0.1]", "needs Young's modulus"),
        ("stress[beam:1@0 y=big E=1e9]", "y must be a number"),
        ("M[beam:1@0 y=0.1]", "M takes no numbers, got y"),
        ("moment[beam:1@0]", "elements have N, V"),
        ("M[beam:1@top]", "M is at a node"),
        ("M[beam:1]", "cannot read"),
        ("von_mises[beam:1@top]", "no set of plates or shells"),
        ("strain[beam:1@0 y=nan]", "must be finite"),
    ],
)
def test_outputs_that_cannot_be_are_named(text, words):
    with pytest.raises(InputError, match=words):
        frf(cantilever(), [text], ["4Y"])


def test_outputs_of_one_quantity_may_have_several_units():
    history = sid.History(["4Y", "M[beam:1@0]", "strain[beam:1@0 y=0.1]"], ["4Y"], np.ones((5, 1)), 10.0)
    assert history.units == ("m/s^2", "N m", "1")
    assert str(parse_output("stress[deck:3@12  y = 0.05 E=2.1e11]")) == "stress[deck:3@12 y=0.05 E=2.1e+11]"
    assert str(parse_output("von_mises[plate@top]")) == "von_mises[plate@top]"


def test_the_number_is_left_out_of_a_set_of_one_element_alone():
    one = frf(cantilever(1), ["M[beam@0]", "M[beam:1@0]"], ["1Y"])[0, :, 0]
    assert one[0] == one[1] != 0
