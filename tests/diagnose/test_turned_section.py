"""Beams in space whose section is turned by 90 degrees: that ranks first, its fit leaves noise, its study is the right one."""

import numpy as np
import pytest
from test_each_cause import begun, require_explained
from test_kindred_causes import SPACE, written_in_space

import structid as sid
from structid.core.errors import InputError, SingularModelError
from structid.diagnose.causes.turned_section import TurnedSection, turned_orientation
from structid.diagnose.screening import _screen_change, linearize_fit, screen_sets
from structid.diagnose.tested_model import TestedModel
from structid.inversion.search.work import PLAIN_CONTEXT, SERIAL

#: The girder with its flat side down: local y up, in place of across.
TURNED = SPACE.replace('name = "girder"', 'name = "girder"\norientation = [0.0, 0.0, 1.0]')


def test_a_turned_section_ranks_first_and_its_fit_alone_explains_all(tmp_path):
    base = begun(written_in_space(tmp_path, TURNED))
    rows = screen_sets(base, SERIAL, "changes of the study")[0]
    first = min(rows, key=lambda row: row.left)
    assert (first.candidate.kind, first.candidate.where) == ("turned_section", ("girder",))
    fitted, _ = require_explained(base, first.candidate, 1.0, tmp_path)
    assert list(fitted.values) == list(base.values)
    assert "orientation = [" in (tmp_path / "again.toml").read_text(encoding="utf-8")
    assert first.candidate.sentence(None) == (
        "the section of girder is turned by 90 degrees: EI about y and z are exchanged"
    )


def test_the_screen_begins_at_the_initial_values_too(tmp_path, monkeypatch):
    """From values that were fitted without the change a linear step leads nowhere."""
    base = begun(written_in_space(tmp_path, TURNED))
    far = type(base)(base.modified, base.theta + np.log([3.0, 0.3]), base.chi_square)
    left = {}
    for is_so in (True, False):
        monkeypatch.setattr(TurnedSection, "is_screened_at_start", is_so)
        rows = screen_sets(far, SERIAL, "changes of the study")[0]
        left[is_so] = min((row.left for row in rows if row.candidate.kind == "turned_section"), default=np.inf)
    assert left[True] < 2 * base.modified.target.n_data
    assert left[False] > 3 * left[True]


C, S = np.cos(np.pi / 6), 0.5
NODES = {
    1: (0.0, 0.0, 0.0),
    2: (0.0, 0.0, 1.0),
    3: (1.0, 0.0, 1.0),
    4: (1.0, 1.0, 1.0),
    5: (C, 0.0, S),
    6: (0.0, C, S),
}


def legs_with_axes(nodes, pairs, orientation):
    """A set of beams, and the local axes of each, (n_beams, 3) by name."""
    beam = sid.SpaceBeam("legs", pairs, 1.0, 2.0, 3.0, orientation=orientation)
    return beam, {name: axis[:, :3] for name, axis in beam.section_directions(nodes).items()}


@pytest.mark.parametrize(
    ("pairs", "guide"),
    [
        ([[1, 2]], [0, 1, 0]),
        ([[1, 2], [2, 3]], None),
        ([[1, 2], [2, 3]], [0, 1, 0]),
        ([[2, 3], [3, 4]], [0, 0, 1]),
        ([[1, 5], [1, 6]], [C, C, S]),  # inclined in two planes: the vertical turns both
    ],
)
def test_the_new_direction_exchanges_the_local_axes_of_every_beam(pairs, guide):
    beam, drawn = legs_with_axes(NODES, pairs, guide)
    _, turned = legs_with_axes(NODES, pairs, turned_orientation(beam, NODES))
    for one, other in (("VY", "VZ"), ("VZ", "VY")):
        np.testing.assert_allclose(np.abs((turned[one] * drawn[other]).sum(axis=1)), 1.0, rtol=1e-9)


def test_no_direction_turns_beams_along_all_axes():
    """Of three beams along three axes one would run along any direction that is across the others, or be turned askew."""
    beam = sid.SpaceBeam("legs", [[1, 2], [2, 3], [3, 4]], 1.0, 2.0, 3.0, orientation=[1.0, 2.0, 3.0])
    assert turned_orientation(beam, NODES) is None


def test_sections_with_equal_stiffnesses_are_not_tried(tmp_path):
    base = begun(written_in_space(tmp_path, SPACE))
    assert [one.where for one in TurnedSection.from_model(base.modified.model, base.modified.problems)] == [("girder",)]


INCLINED = {1: (0.0, 0.0, 0.0), 2: (1.0, 0.0, 2.0), 3: (5.0, 0.0, 0.0), 4: (5.0, 1.0, 2.0)}


@pytest.mark.parametrize("guide", [None, [0, 0, 1], [1, 0, 0], [0, 1, 0], [1, 2, 3]])
def test_beams_inclined_in_two_planes_are_turned_by_one_direction(guide):
    beam, drawn = legs_with_axes(INCLINED, [[1, 2], [3, 4]], guide)
    _, turned = legs_with_axes(INCLINED, [[1, 2], [3, 4]], turned_orientation(beam, INCLINED))
    np.testing.assert_allclose(np.abs((turned["VY"] * drawn["VZ"]).sum(axis=1)), 1.0, rtol=1e-9)


def tried(bending_y, unknowns):
    legs = sid.SpaceBeam("legs", [[1, 2], [2, 3]], 1.0, bending_y, 3.0, orientation=[0, 1, 0])
    arm = sid.SpaceBeam("arm", [[3, 4]], 1.0, 2.0, 3.0, orientation=[0, 0, 1])
    structure = sid.Structure(NODES, [legs, arm], fixed=[f"1{motion}" for motion in ("X", "Y", "Z", "RX", "RY", "RZ")])
    unknown = sid.parameters(structure, [sid.Unknown("mass", "arm"), *unknowns])
    record = sid.FrfRecord(np.arange(5.0, 9.0), np.ones((4, 1, 1)), "4X", "4X", "receptance")
    model = TestedModel((sid.Setup(structure, unknown, record),), sid.IdentifyOptions())
    return [one.where for one in TurnedSection.from_model(model, ())], model


def about(axis, **more):
    return sid.Unknown(f"bending_stiffness_{axis}", "legs", **more)


@pytest.mark.parametrize(
    ("bending_y", "unknowns", "is_tried"),
    [
        (2.0, [], True),
        (3.0, [], False),
        (3.0, [about("y")], True),
        (3.0, [about("z")], True),
        (2.0, [about("y"), about("z")], False),
        (2.0, [about("y", prior=sid.Prior(2.0, 0.1)), about("z")], True),
        ([2.0, 4.0], [about("y"), about("z")], True),
    ],
)
def test_sets_are_tried_whose_turning_makes_a_difference(bending_y, unknowns, is_tried):
    """With one stiffness unknown equal starts say nothing; with both free their fit is the same turned or not."""
    wanted = [("legs", "arm"), ("legs",), ("arm",)] if is_tried else [("arm",)]
    assert tried(bending_y, unknowns)[0] == wanted


def test_all_sets_are_turned_together_and_what_cannot_be_turned_is_told():
    wheres, model = tried(2.0, [])
    together = TurnedSection(where=wheres[0]).edits(model, 1.0)
    assert [(edit.name, edit.value) for edit in together] == [("legs", [1.0, 0.0, 1.0]), ("arm", [1.0, 0.0, 0.0])]
    with pytest.raises(InputError, match="'rods' has no beams in space that one `orientation` turns; put"):
        TurnedSection(where=("rods",)).edits(model, 1.0)


def test_each_start_of_a_screen_counts_by_itself(tmp_path, monkeypatch):
    """One that fails leaves the other, equal ones are one, and what changes nothing at the fit is seen from the start."""
    base = begun(written_in_space(tmp_path, TURNED))
    far = type(base)(base.modified, base.theta + np.log([1.2, 0.8]), base.chi_square)
    target, seen, broken = type(base.modified.coarse.target), [], []
    honest, turned = target.linearize, TurnedSection(where=("girder",))

    def linearized(problem, theta, *arguments):
        seen.append(np.array(theta))
        if any(np.array_equal(theta, one) for one in broken):
            raise SingularModelError("no step from here")
        return honest(problem, theta, *arguments)

    def screened(fit, candidate):
        at = linearize_fit(fit)
        seen.clear()
        return _screen_change(at, (candidate, 1.0), PLAIN_CONTEXT)["left"]

    monkeypatch.setattr(target, "linearize", linearized)
    assert np.isfinite(screened(base, turned))
    assert len(seen) == 1
    both = screened(far, turned)
    fitted, start = seen
    broken[:] = [start]
    from_fit = screened(far, turned)
    assert both < from_fit < np.inf
    monkeypatch.setattr(TurnedSection, "edits", lambda *arguments: [])
    broken.clear()
    assert np.isfinite(screened(far, turned))
    assert [one.tolist() for one in seen] == [fitted.tolist(), start.tolist()]
