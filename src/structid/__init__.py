"""structid: mass, damping and stiffness of a structure from vibration measurements.

Verbs are functions (`plan`, `estimate`, `parameters`), nouns with a capital are what they take or return (`Plan`, `Estimate`,
`Parameters`). Public names by their noun:

Structures: Structure, Dof, parse_dof, PointMass, RotaryInertia, Spring, Dashpot, Friction, Joint, Bar, Beam,
    SpaceBeam, Plane, Membrane, Plate, Shell, Solid, MatrixGroup, from_matrices, Blocks, RigidLink, Base, Component,
    MeasuredComponent, Constraint, Mesh, read_mesh, MeshPoint, mesh_points, AimedSensor, nearest_nodes
Unknowns: Unknown, Parameters, parameters, Prior, joint_prior, Coupling, Field, Smoothness, Sparsity,
    ChannelUnknown, channel_errors
Records: FrfRecord, TimeRecord, ModalRecord, read_record, write_record, CsvLayout, ReadOptions, frf_from_time,
    from_repeats, with_coherence_noise, with_declared_noise, prepare, Preparation, right_half_plane,
    signal_checks
Identification: identify, identify_together, IdentifyOptions, Identification, Setup, TimeSetup, ModalSetup,
    ModalSettings, identify_time, TimeOptions, TimeFit, load_study, run_study,
    results_view, ResultsView
Diagnosis: explain, Diagnosis, Cause
Modes: identify_modes, merge_modes, modes_of_file, ModesOptions, pseudo_rayleigh
Test and model: correlated_modes, correlated_responses, pair_modes, expand, mac, comac, ecomac, orthogonality,
    frac, fdac, subspace_angles
States: Comparison, compare_states, compare_jointly
Planning: plan, Plan, PlanOptions
Use: predict, predict_change, Frf, History, Maxima, Spectrum, RootMeanSquare, Extremes, NaturalModes, ModalParticipation,
    AddMass, Scale, AddSupport, AddTunedMassDamper, tune_damper, Remove, sense, UnknownForces, support_acceleration, state_space
Problems and estimators: estimate, Estimate, Status, Search, LevenbergMarquardt, GaussNewton, MatrixFree,
    FrfProblem, SpectraProblem, spectra_problem, ModalProblem, JointProblem
Motion, sample by sample: Motion, Oscillation, RecursiveMotionFit, identify_motion, motion_fit,
    recorded_motion, completed, least_squares_bias
Simulation: simulated_record, simulated_time_record, harmonic_transient, sampled_transient
Errors: StructidError, InputError, FileError
"""

from structid._version import __version__ as __version__
from structid.lazy import lazy

_GONE = {
    "frf_from_rest": "frf_from_time with an exponential window, or spectra_problem, which fits an impact as it is",
    "joint_modes": "merge_modes, which finds as many modes, and their shapes more exactly",
}
__getattr__, __dir__, __all__ = lazy(__name__, __file__, _GONE)
