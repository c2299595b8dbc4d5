"""structid: mass, damping and stiffness of a structure from vibration measurements."""

from structid._version import __version__
from structid.dof import Dof, parse_dof
from structid.dynamics import harmonic_transient, sampled_transient
from structid.errors import FileError, InputError, StructidError
from structid.estimation import Estimate, GaussNewton, JointProblem, LevenbergMarquardt, MatrixFree, Search, Status
from structid.estimation.comparison.comparison import Comparison, compare_jointly, compare_states
from structid.estimation.estimate import estimate
from structid.identification.frf_setup import Setup
from structid.identification.identified import Identification
from structid.identification.identify import identify, identify_together
from structid.identification.modal_setup import ModalSettings, ModalSetup
from structid.identification.options import IdentifyOptions
from structid.identification.time_setup import TimeFit, TimeSetup
from structid.modal import ModalRecord, identify_modes, joint_modes, merge_modes
from structid.modal.rayleigh.pseudo_rayleigh import pseudo_rayleigh
from structid.observation import (
    ChannelUnknown,
    FrfProblem,
    ModalProblem,
    Motion,
    Oscillation,
    RecursiveMotionFit,
    SpectraProblem,
    TimeOptions,
    completed,
    identify_motion,
    least_squares_bias,
    recorded_motion,
    simulated_record,
    simulated_time_record,
)
from structid.observation.channel_errors import channel_errors
from structid.observation.motion.fit import motion_fit
from structid.observation.time.identify_time import identify_time
from structid.observation.time.spectra import spectra_problem
from structid.planning.plan import plan
from structid.planning.planned import Plan, PlanOptions
from structid.records import (
    FrfRecord,
    Preparation,
    ReadOptions,
    TimeRecord,
    frf_from_rest,
    frf_from_time,
    from_repeats,
    prepare,
    read_record,
    right_half_plane,
    with_coherence_noise,
    with_declared_noise,
    write_record,
)
from structid.records.quality.signal_checks import signal_checks
from structid.similarity import frac, mac, subspace_angles
from structid.structure import (
    Bar,
    Beam,
    Blocks,
    Constraint,
    Dashpot,
    Friction,
    MatrixGroup,
    Membrane,
    Plane,
    Plate,
    PointMass,
    RigidLink,
    RotaryInertia,
    Shell,
    Solid,
    SpaceBeam,
    Spring,
    Structure,
    from_matrices,
)
from structid.structure.mesh_point import MeshPoint, mesh_points
from structid.structure.meshes import Mesh, read_mesh
from structid.study.run.run import load_study, run_study
from structid.unknowns import Coupling, Field, Parameters, Prior, Smoothness, Sparsity, Unknown, joint_prior
from structid.unknowns.parameters import parameters

__all__ = [
    "Bar",
    "Beam",
    "Blocks",
    "ChannelUnknown",
    "Comparison",
    "Constraint",
    "Coupling",
    "Dashpot",
    "Dof",
    "Estimate",
    "Field",
    "FileError",
    "FrfProblem",
    "FrfRecord",
    "Friction",
    "GaussNewton",
    "Identification",
    "IdentifyOptions",
    "InputError",
    "JointProblem",
    "LevenbergMarquardt",
    "MatrixFree",
    "MatrixGroup",
    "Membrane",
    "Mesh",
    "MeshPoint",
    "ModalProblem",
    "ModalRecord",
    "ModalSettings",
    "ModalSetup",
    "Motion",
    "Oscillation",
    "Parameters",
    "Plan",
    "PlanOptions",
    "Plane",
    "Plate",
    "PointMass",
    "Preparation",
    "Prior",
    "ReadOptions",
    "RecursiveMotionFit",
    "RigidLink",
    "RotaryInertia",
    "Search",
    "Setup",
    "Shell",
    "Smoothness",
    "Solid",
    "SpaceBeam",
    "Sparsity",
    "SpectraProblem",
    "Spring",
    "Status",
    "StructidError",
    "Structure",
    "TimeFit",
    "TimeOptions",
    "TimeRecord",
    "TimeSetup",
    "Unknown",
    "__version__",
    "channel_errors",
    "compare_jointly",
    "compare_states",
    "completed",
    "estimate",
    "frac",
    "frf_from_rest",
    "frf_from_time",
    "from_matrices",
    "from_repeats",
    "harmonic_transient",
    "identify",
    "identify_modes",
    "identify_motion",
    "identify_time",
    "identify_together",
    "joint_modes",
    "joint_prior",
    "least_squares_bias",
    "load_study",
    "mac",
    "merge_modes",
    "mesh_points",
    "motion_fit",
    "parameters",
    "parse_dof",
    "plan",
    "prepare",
    "pseudo_rayleigh",
    "read_mesh",
    "read_record",
    "recorded_motion",
    "right_half_plane",
    "run_study",
    "sampled_transient",
    "signal_checks",
    "simulated_record",
    "simulated_time_record",
    "spectra_problem",
    "subspace_angles",
    "with_coherence_noise",
    "with_declared_noise",
    "write_record",
]
