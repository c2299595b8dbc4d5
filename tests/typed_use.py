"""A user's script, which type checkers must accept in strict mode; it is read, not run."""

import numpy as np

import structid as sid

beam = sid.Beam("beam", [[i, i + 1] for i in range(6)], 1.0, [10.0] * 6, loss_factor=0.02)
structure = sid.Structure({i: float(i) for i in range(7)}, [beam, sid.PointMass("tip", [6], 0.2)], fixed=["0Y", "0RZ"])
unknown = sid.parameters(structure, [sid.Unknown("mass", "beam", each=True), sid.Unknown("loss_factor", "beam")])
like = sid.FrfRecord(np.linspace(0.02, 1.6, 400), np.ones((400, 2, 1)), ("6Y+", "3Y+"), ("6Y+",), "accelerance")
record = sid.simulated_record(structure, unknown, like, 0.01, np.random.default_rng(1))
found = sid.identify(structure, unknown, record, sid.IdentifyOptions(band=(0.1, 1.5)))
estimate = found.estimate
value = estimate["mass[beam:1]"].value
ends = estimate.interval(0.95)
names = estimate.names
text = found.summary()
figure = found.plot_frf("6Y")
picture = structure.plot_structure()
study = sid.load_study("study.toml")
result = sid.run_study(study)
answer = result.identification.estimate
modes = sid.modes_of_file(
    "ambient.npy", sid.ModesOptions(band=(1.0, 5.0)), sid.ReadOptions(sampling_rate=20.0, channels=("1X",))
)
shape = modes.plot_modes(1)
planned = sid.plan(structure, unknown, sid.PlanOptions(np.geomspace(0.2, 40, 400).tolist(), n_sensors=2))
worst = planned.chosen.worst_std
change = sid.compare_states(estimate, answer)
changed = change.changed
similar = sid.mac(np.eye(3), np.eye(3))
time_record = sid.TimeRecord(20.0, np.zeros((10, 1)), ("1X",), ("acceleration",))
ready = sid.prepare(time_record).record
transient = sid.identify_time(structure, unknown, time_record, sid.TimeOptions(initial="unknown"))
both = sid.identify_together([sid.Setup(structure, unknown, record), sid.TimeSetup(structure, unknown, time_record)])
modal = sid.identify_modes(time_record, "ssi_cov")
merged = sid.merge_modes([modal, modal])
read = sid.read_record("frf.npz")
sid.write_record("frf.h5", read)
problem = sid.FrfProblem(structure, unknown, record)
alone = sid.estimate(problem, sid.LevenbergMarquardt(max_iterations=5))
SEEN = (
    value,
    ends,
    names,
    text,
    figure,
    picture,
    shape,
    worst,
    changed,
    similar,
    ready,
    transient,
    both,
    merged,
    alone,
)
