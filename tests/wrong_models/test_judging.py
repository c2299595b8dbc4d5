"""What counts as right, and the runner against a structid that answers as told."""

import json

import pytest
from wrong_models.cases import cases
from wrong_models.faults import Fault, accepted
from wrong_models.judging import judged, names, places, summary
from wrong_models.rigs import RIGS

from wrong_models import running


def truth(*faults, harmless=False):
    told = [
        {"kind": f.kind, "where": f.where, "size": f.size, "accepted": accepted(f, RIGS["portal"]().table)}
        for f in faults
    ]
    return {"name": "n", "record": "frf", "parameters": {"a": 1.0, "b": None}, "faults": told, "harmless": harmless}


def answer(value=1.0, std=0.01, causes=(), **more):
    row = {"name": "a", "value": value, "std": std, "interval_95": [value - 2 * std, value + 2 * std]}
    return {"parameters": [row, {**row, "name": "b"}], "causes": list(causes), "chi_square_per_dof": 1.0, **more}


def test_places_come_in_pieces():
    assert places("columns:2/4RZ+") == {"columns:2", "columns", "4RZ", "4"}
    assert places(["9:-Y", "7X"]) == {"9Y", "9", "7X", "7"}
    assert places({"node": 5}) == {"5"}
    assert places(None) == set()


@pytest.mark.parametrize(
    "fault, kind, where, right",
    [
        ("support 11RZ 1", "support", "11RZ", True),
        ("support 11RZ 1", "support", "11X", False),
        ("support 11RZ 1", "joint", "11RZ", False),
        ("mass 9 1", "mass", "9X", True),
        ("mass 9 1", "mass", ["8"], False),
        ("joint girder:1/4RZ 1", "joint", "left:3/4RZ", True),
        ("joint girder:1/4RZ 1", "joint", "girder:1/5RZ", False),
        ("swap 4X 7Y", "swap", ["7Y+", "4X+"], True),
        ("swap 4X 7Y", "swap", ["4X", "5Y"], False),
        ("shear left,right 1", "shear", ["right"], True),
        ("unit 9X 9.8", "sensor_gain", "9X", True),
        ("clipping 9X 0.4", "channel", "9X", True),
        ("mesh left 3", "mesh", None, True),
        ("untied left:2 x*2", "untied", "left:3", False),
    ],
)
def test_causes_name_faults(fault, kind, where, right):
    [told] = truth(Fault(*fault.split()))["faults"]
    assert names({"kind": kind, "where": where}, told) is right


@pytest.mark.parametrize(
    "value, std, code, verdict, wrong",
    [
        (1.2, 0.01, 0, None, True),
        (1.2, 0.01, 0, "approximate", True),
        (1.2, 0.01, 3, "wrong_model", False),
        (1.2, 0.01, 1, "undetermined", False),
        (1.2, 0.1, 0, "sound", False),
        (1.04, 0.001, 0, "sound", False),
        (1.2, 0.01, 1, None, False),
    ],
)
def test_confidently_wrong(value, std, code, verdict, wrong):
    more = {} if verdict is None else {"verdict": verdict}
    assert judged(truth(), answer(value, std, **more), code, 1.0).confidently_wrong is wrong


def test_intervals_ranks_and_false_causes():
    mass = {"kind": "mass", "where": "9"}
    other = {"kind": "mass", "where": "5"}
    one = judged(truth(Fault("mass", "9", "1")), answer(1.03, causes=[other, mass], verdict="wrong_model"), 3, 1.0)
    assert (one.covered, one.counted, one.ranks, one.false_causes) == (0, 1, (2,), ())
    twin = judged(truth(Fault("mass", "9", "1"), harmless=True), answer(causes=[other, mass], verdict="sound"), 0, 1.0)
    assert (twin.covered, twin.ranks, twin.false_causes, twin.faults) == (1, (), ("mass 5",), ())
    none = judged(truth(), None, 2, 1.0)
    assert (none.said, none.counted, none.confidently_wrong) == ("exit 2", 0, False)


def test_bars():
    mass, gain = Fault("mass", "9", "1"), Fault("sensor_gain", "4X", "2")
    named = [{"kind": "x"}, {"kind": "mass", "where": "9"}, {"kind": "sensor_gain", "where": "4X"}]
    rows = [
        judged(truth(mass), answer(causes=named[1:], verdict="wrong_model"), 3, 1.0),
        judged(truth(mass), answer(1.2, causes=named, verdict="approximate"), 0, 1.0),
        judged(truth(mass, gain), answer(causes=named, verdict="wrong_model"), 3, 1.0),
        judged(truth(), answer(verdict="wrong_model"), 3, 1.0),
        judged(truth(), answer(verdict="sound"), 0, 1.0),
    ]
    found = {row["what"]: (row["figure"], row["met"]) for row in summary(rows)}
    assert found["single fault: cause first"] == (0.5, False)
    assert found["single fault: cause among the first three"] == (1.0, True)
    assert found["two faults: both among the first 4"] == (1.0, True)
    assert found["confidently wrong"] == (1, False)
    assert found["right model: called wrong"] == (0.5, False)
    assert found["right model: false causes"] == (0.0, True)
    assert found["single fault, not called wrong: 95 % intervals"] == (0.0, False)
    assert summary([judged(truth(mass), answer(), 0, 1.0)])[0]["met"] is None


def _stand_in(folder, monkeypatch, body):
    """A structid that runs `body` in the folder of the study."""
    package = folder / "structid"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "__main__.py").write_text(f"import json, pathlib, sys, time\n{body}\n")
    monkeypatch.setenv("PYTHONPATH", str(folder))


def test_runner_reads_verdict_and_causes(tmp_path, monkeypatch, capsys):
    body = """
told = json.loads(pathlib.Path("truth.json").read_text())
causes = [{"kind": f["kind"], "where": f["where"]} for f in told["faults"]]
rows = [{"name": n, "value": v, "std": v / 100, "interval_95": [v * 0.9, v * 1.1]} for n, v in told["parameters"].items()]
pathlib.Path("results").mkdir()
found = {"parameters": rows, "causes": causes, "verdict": "wrong_model" if causes else "sound", "chi_square_per_dof": 2.0}
pathlib.Path("results/estimate.json").write_text(json.dumps(found))
sys.exit(3 if causes else 0)
"""
    _stand_in(tmp_path, monkeypatch, body)
    chosen = ["two_span-frf-near-mass-6", "two_span-frf-near-twin", "two_span-frf-near-joint-left-3-4RZ-mass-8"]
    code = running.main(["--only", *chosen, "--out", str(tmp_path / "out")])
    kept = json.loads((tmp_path / "out" / "results.json").read_text())
    assert code == 0
    assert [one["verdict"] for one in kept["studies"]] == ["wrong_model", "wrong_model", "sound"]
    assert [row["met"] for row in kept["summary"][:6]] == [True] * 6
    assert "cause first  1" in capsys.readouterr().out


def test_runner_ends_what_takes_too_long(tmp_path, monkeypatch):
    _stand_in(tmp_path, monkeypatch, "time.sleep(60)")
    [case] = [one for one in cases("development") if one.name == "two_span-frf-near-twin"]
    one = running.run(case, tmp_path / "study", 0.5)
    assert one.said == "time out"
    assert not one.confidently_wrong
    assert 0.5 <= one.seconds < 60.0
