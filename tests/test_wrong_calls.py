"""Calls as a newcomer may make them: each error names the argument, what is wrong with it, and the remedy."""

import numpy as np
import pytest

import structid as sid

BEAM = sid.Beam("beam", [[0, 1]], mass=2.0, bending_stiffness=150.0)
STRUCTURE = sid.Structure({0: 0.0, 1: 0.3}, [BEAM], fixed=["0"])
UNKNOWN = sid.parameters(STRUCTURE, [sid.Unknown("mass", "beam")])
RECORD = sid.FrfRecord(np.arange(1.0, 9), np.full((8, 1, 1), 1j), ["1Y"], ["1Y"], "accelerance")
MADE_BY = r"make it by `read_record` or `TimeRecord`"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: sid.with_declared_noise("a.uff", 0.01),
            r"`record` must be of class FrfRecord, got str; make it by `read_",
        ),
        (
            lambda: sid.with_declared_noise(RECORD, 10),
            r"`relative` must be at most 1, .* got 10, .* 1000 %; write 0.1 for 10 %, .* above 100 % as `absolute`",
        ),
        (lambda: sid.with_coherence_noise(None, 10), r"`record` must be of class FrfRecord, got NoneType"),
        (lambda: sid.frf_from_time(np.ones(3)), rf"`records\[0\]` must be of class TimeRecord, got float64; {MADE_BY}"),
        (lambda: sid.frf_from_time(RECORD), rf"`records` must be of class TimeRecord, got FrfRecord; {MADE_BY}"),
        (lambda: sid.frf_from_time(None), rf"`records` must be of class TimeRecord, got NoneType; {MADE_BY}"),
        (lambda: sid.prepare(STRUCTURE), rf"`record` must be of class TimeRecord, got Structure; {MADE_BY}"),
        (lambda: sid.signal_checks(None), rf"`record` must be of class TimeRecord, got NoneType; {MADE_BY}"),
        (lambda: sid.identify_time(STRUCTURE, UNKNOWN, RECORD), r"`record` must be of class TimeRecord, got FrfRecord"),
        (
            lambda: sid.identify_time(UNKNOWN, STRUCTURE, RECORD),
            r"`structure` must be of class Structure, got Parameters",
        ),
        (
            lambda: sid.identify_motion(STRUCTURE, UNKNOWN, RECORD),
            r"`record` must be of class TimeRecord or Motion, got Frf",
        ),
        (
            lambda: sid.identify_motion(STRUCTURE, BEAM, RECORD),
            r"`unknown` must be of class Parameters, got Beam; make it by",
        ),
        (
            lambda: sid.estimate(STRUCTURE),
            r"`problem` must be of class Problem, got Structure; .*a structure goes to `identify`",
        ),
        (
            lambda: sid.results_view("results"),
            r"`identification` must be of class Identification, got str; make it by `identi",
        ),
        (
            lambda: sid.from_matrices(np.eye(2), ["1X"]),
            r'`groups` must be of class Mapping, got ndarray; write \{"all": \{"mas',
        ),
        (
            lambda: sid.from_matrices({"all": np.eye(2)}, ["1X", "2X"]),
            r"`groups\['all'\]` must be of class Mapping, got ndarray; write \{\"mass\": M, \"stiffness\": K\}",
        ),
        (
            lambda: sid.from_matrices({"all": {"mas": np.eye(2)}}, ["1X", "2X"]),
            r"`groups\['all'\]` must have no keys but mass, stiffness, damping, loss_factor, got 'mas'; rename it",
        ),
        (
            lambda: sid.load_study(None),
            r"`path` must be of class str or PathLike, got NoneType; give the path of a study",
        ),
        (lambda: sid.load_study(5), r"`path` must be of class str or PathLike, got int; give the path of a study file"),
        (
            lambda: sid.parameters(None, [sid.Unknown("mass", "beam")]),
            r"`structure` must be of class Structure, got NoneType; make it by `Structure\(nodes, elements, fixed\)`",
        ),
        (
            lambda: sid.parameters(STRUCTURE, None),
            r"`unknowns` must be of class Unknown or Iterable, got NoneType; write \[Unknown\(",
        ),
        (
            lambda: sid.simulated_record(STRUCTURE, UNKNOWN, None, 0.01, np.random.default_rng(1)),
            r"`like` must be of class FrfRecord, got NoneType; make it by `FrfRecord`, with any values at its lines",
        ),
        (
            lambda: sid.simulated_record(STRUCTURE, UNKNOWN, RECORD, 0.01),
            r"`rng` must be of class Generator, got NoneType; noise is drawn by .*np.random.default_rng\(1\)",
        ),
        (
            lambda: sid.simulated_record(STRUCTURE, UNKNOWN, RECORD, 0.01, 1),
            r"`rng` must be of class Generator, got int; .*np.random.default_rng\(1\)",
        ),
        (
            lambda: sid.simulated_record(STRUCTURE, UNKNOWN, RECORD, "1 %", np.random.default_rng(1)),
            r"`relative_noise` must be a finite number of at least 0, got '1 %'; 0.01 is 1 %",
        ),
        (
            lambda: sid.simulated_record(STRUCTURE, UNKNOWN, RECORD, -0.01, np.random.default_rng(1)),
            r"`relative_noise` must be a finite number of at least 0, got -0.01",
        ),
        (
            lambda: sid.Beam("beam", [[0, 1]], mass=2.0, EI=150.0),
            r"`EI` is no argument of Beam: write `bending_stiffness`; the arguments of Beam are name, nodes, mass, bending_st",
        ),
        (
            lambda: sid.Beam("beam", [[0, 1]], mass=2.0, bending_stifness=150.0),
            r"`bending_stifness` is no argument of Beam: write `bending_stiffness`; ",
        ),
        (
            lambda: sid.Beam("beam", [[0, 1]], density=7850.0),
            r"`density` is no argument of Beam; the arguments of Beam are name, ",
        ),
        (
            lambda: sid.Beam("beam", [[0, 1]]),
            r"Beam: missing a required argument: 'mass'; the arguments of Beam are name, nodes, mass, ",
        ),
        (lambda: sid.simulated_record(None, UNKNOWN, RECORD), r"`structure` must be of class Structure, got NoneType"),
        (
            lambda: sid.simulated_time_record(STRUCTURE, UNKNOWN, RECORD),
            r"`like` must be of class TimeRecord, got FrfRecord; make it by `TimeRecord`",
        ),
        (
            lambda: sid.Structure({0: 0.0, 1: 1.0}, [BEAM], fixed=["0Q"]),
            r"`fixed`: cannot read '0Q' as a degree of freedom; w",
        ),
        (
            lambda: sid.Structure({0: 0.0, 1: 1.0}, [BEAM], fixed=0),
            r"`fixed`: a list of degrees of freedom is needed, such as",
        ),
        (
            lambda: sid.Structure({0: 0.0, 1: 1.0}, [BEAM], fixed={"0": "Y"}),
            r"`fixed`: a list of degrees of freedom is needed, such as \[\"1X\", \"2\"\], got \{'0': 'Y'\}",
        ),
        (
            lambda: sid.Structure({0: 0.0, 1: 1.0}, [BEAM], fixed=[0]),
            r"`fixed`: cannot read 0 as .*, as in 12Z\+ or 3RX-, or a whole node, as in \"12\"",
        ),
        (
            lambda: sid.Structure({0: 0.0, 1: 1.0}, [BEAM], fixed=["0 Y Q"]),
            r"`fixed`: cannot read '0 Y Q' as .*, as in 12Z\+ or 3RX-, or a whole node, as in \"12\"",
        ),
        (
            lambda: sid.FrfRecord([1.0], np.full((1, 1, 1), 1j), ["Y1"], ["1Y"], "mobility"),
            r"`outputs`: cannot read 'Y1' as",
        ),
        (
            lambda: sid.FrfRecord([1.0], np.full((1, 1, 1), 1j), ["1Y"], [5], "mobility"),
            r"`inputs`: cannot read 5 as a degree",
        ),
        (
            lambda: sid.TimeRecord(9.0, np.ones((4, 1)), ["1"], ["force"]),
            r"`channels`: cannot read '1' as a degree of freedom",
        ),
        (
            lambda: sid.IdentifyOptions(band=(1.0, np.inf)),
            r"`band` must end at a finite frequency, got inf Hz; give the highest that is wanted, .* its last or any above it",
        ),
        (
            lambda: sid.parameters(STRUCTURE, [sid.Unknown("mass", "beam", prior=5)]),
            r"`prior of mass\[beam\]` must be of class Prior, got int; write `Prior\(mean, std\)`",
        ),
    ],
)
def test_an_error_names_argument_condition_and_remedy(call, words):
    with pytest.raises(sid.InputError, match=words):
        call()


def test_supports_are_named_as_in_a_study():
    assert [dof.place for dof in STRUCTURE.fixed] == ["0X", "0Y", "0RZ"]
    several = sid.Structure({0: 0.0, 1: 0.3}, [BEAM], fixed=["0 Y RZ"])
    assert [dof.place for dof in several.fixed] == ["0Y", "0RZ"]


def test_elements_as_drawn_are_said_in_the_summary():
    grid = sid.FrfRecord(np.linspace(1, 60, 40), np.full((40, 1, 1), 1j), ["1Y"], ["1Y"], "accelerance")
    record = sid.simulated_record(STRUCTURE, UNKNOWN, grid, 0.01, np.random.default_rng(1))
    said = "The elements of beam are as drawn, and not judged for their length"
    assert said in str(sid.identify(STRUCTURE, UNKNOWN, record))
    assert said in str(sid.identify_together([sid.Setup(STRUCTURE, UNKNOWN, record)]))
    finer = sid.Structure({0: 0.0, 1: 0.3}, [BEAM], fixed=["0"], subdivide=2)
    assert said not in str(sid.identify(finer, sid.parameters(finer, [sid.Unknown("mass", "beam")]), record))


def test_an_element_set_is_shown_by_what_it_has():
    assert repr(BEAM) == "<Beam 'beam': 1 element, mass 2 kg/m, bending_stiffness 150 N m^2>"
    springs = sid.Spring("springs", ["0X", "1X"], ["1X", "2X"], stiffness=[900.0, 800.0], loss_factor=0.02)
    assert repr(springs) == "<Spring 'springs': 2 elements, stiffness 800 to 900 N/m, loss_factor 0.02>"
