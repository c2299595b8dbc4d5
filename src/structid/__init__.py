"""structid: mass, damping and stiffness of a structure from vibration measurements."""

from structid._version import __version__
from structid.compare import frac, mac, subspace_angles
from structid.dof import Dof, parse_dof
from structid.errors import FileError, InputError, StructidError
from structid.estimation import Estimate, GaussNewton, LevenbergMarquardt, Status, estimate
from structid.modal import ModalRecord, pseudo_rayleigh
from structid.observation import FrfProblem, simulated_record
from structid.parameters import Parameters, Prior, Unknown, parameters
from structid.records import (
    FrfRecord,
    ReadOptions,
    TimeRecord,
    frf_from_time,
    from_repeats,
    read_record,
    with_coherence_noise,
    with_declared_noise,
    write_record,
)
from structid.structure import (
    Bar,
    Beam,
    Blocks,
    Constraint,
    Dashpot,
    Friction,
    MatrixGroup,
    Membrane,
    PointMass,
    RigidLink,
    RotaryInertia,
    SpaceBeam,
    Spring,
    Structure,
    from_matrices,
)
from structid.study.identification import Identification, IdentifyOptions, identify
from structid.study.run import load_study, run_study

__all__ = [
    "Bar",
    "Beam",
    "Blocks",
    "Constraint",
    "Dashpot",
    "Dof",
    "Estimate",
    "FileError",
    "FrfProblem",
    "FrfRecord",
    "Friction",
    "GaussNewton",
    "Identification",
    "IdentifyOptions",
    "InputError",
    "LevenbergMarquardt",
    "MatrixGroup",
    "Membrane",
    "ModalRecord",
    "Parameters",
    "PointMass",
    "Prior",
    "ReadOptions",
    "RigidLink",
    "RotaryInertia",
    "SpaceBeam",
    "Spring",
    "Status",
    "StructidError",
    "Structure",
    "TimeRecord",
    "Unknown",
    "__version__",
    "estimate",
    "frac",
    "frf_from_time",
    "from_matrices",
    "from_repeats",
    "identify",
    "load_study",
    "mac",
    "parameters",
    "parse_dof",
    "pseudo_rayleigh",
    "read_record",
    "run_study",
    "simulated_record",
    "subspace_angles",
    "with_coherence_noise",
    "with_declared_noise",
    "write_record",
]
