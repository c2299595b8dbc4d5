"""Identification from time records: one entry, three estimators."""

from __future__ import annotations

from structid.core.errors import InputError, require_class
from structid.fem import Structure
from structid.forward.time.instrumental import identified_by_instruments
from structid.forward.time.options import TimeOptions
from structid.forward.time.output_error_search import identified_by_output_error
from structid.forward.time.weak_form import identified_by_weak_form
from structid.inversion import Estimate
from structid.inversion.search.work import SERIAL, StageProgress, TaskExecutor
from structid.records import TimeRecord
from structid.unknowns import Parameters


def identify_time(
    structure: Structure,
    unknown: Parameters,
    record: TimeRecord,
    options: TimeOptions | None = None,
    work: TaskExecutor = SERIAL,
    progress: StageProgress | None = None,
) -> Estimate:
    """Masses, viscous dampings and stiffnesses from time histories, consistent under noise in every channel.

    ================  =====================================  ===================  ==================================
    `options.method`  sensors                                start of the motion  what it costs
    ================  =====================================  ===================  ==================================
    ``output_error``  any, of any kind                       rest, or unknown     a search; the smallest errors
    ``instrumental``  acceleration, velocity (with damping)  rest, or measured    linear; a simulation an iteration
                      and displacement of every free dof
    ``weak``          one of the three of every free dof     anything             linear; a covariance an iteration
    ================  =====================================  ===================  ==================================

    Parameters
    ----------
    structure : Structure
        At most 200 free degrees of freedom; larger models must be condensed first.
    unknown : Parameters
        Masses, viscous dampings, stiffnesses; no loss factors, no friction. Priors and bounds are used by
        ``output_error`` and refused or left aside by the linear methods.
    record : TimeRecord
        Motion and force channels, with the noise variance of each (independent from sample to sample). A force with
        variance 0 is known; otherwise its errors are estimated with the parameters (``output_error``), weighed
        (``instrumental``, ``weak``), or, for an `Oscillation`, its amplitude is. Channels with variance 0 can only
        serve ``instrumental``, or to start from.
    options : TimeOptions, optional
    work : TaskExecutor
        Where the searches of ``output_error`` run, and whether they and the iterations of ``instrumental`` are kept.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.

    Returns
    -------
    Estimate
        For ``instrumental`` without declared variance the standard deviations come from the residual, and chi-square
        is NaN. Values that the record does not determine have a standard deviation of NaN or above their size, and the
        status ``NOT_IDENTIFIABLE``.

    Raises
    ------
    InputError
        If channels, forces or noise levels are missing, or the model has matrices that no time-domain equation has.

    Notes
    -----
    Between samples the force is a straight line (or constant, or an oscillation), and for such a force the model is
    exact: modal state space and the matrix exponential. Motion faster than half the sampling rate is no obstacle to
    ``output_error`` and ``instrumental``; ``weak`` needs it sampled well.

    Output error with noisy force samples estimates every one of them, at most 1000. Instruments simulated from noisy
    force samples share their noise, which leaves a bias of the order of the squared relative noise of the force; an
    `Oscillation`, whose amplitude many samples fix, has none to speak of.

    Output error goes from few samples to ever more of them. Where the initial values and two random starts end at
    minima that miss the noise, as where modes turn far between two samples, a start follows that asks only for what the
    errors of the initial values leave predictable: up to 20 times 100 simulations of a few samples (or of four for each
    parameter), with no derivative; up to five more of these follow, mostly about the best minimum so far. See
    `structid.inversion.search.posterior_linearization`.

    References
    ----------
    Ljung (1999), System Identification, 2nd ed., chapter 7: output error. Young and Jakeman (1979), Int. J. Control 29:
    refined instrumental variables. Garcia-Fernandez et al. (2015), IEEE Trans. Signal
    Process. 63, 5561-5573: posterior linearization. Bortz, Messenger and Dukic (2023), Bull. Math. Biol. 85, 110:
    the weak form.

    Examples
    --------
    >>> import numpy as np
    >>> from structid import Dashpot, PointMass, Spring, Structure, TimeRecord, Unknown, parameters
    >>> from structid.forward import simulated_time_record
    >>> parts = [PointMass("m", [1], 2.0), Spring("k", "1X", stiffness=50.0), Dashpot("c", "1X", viscous_damping=1.0)]
    >>> oscillator = Structure({1: 0.0}, parts, active=["X"])
    >>> unknowns = [Unknown("mass", "m"), Unknown("stiffness", "k"), Unknown("viscous_damping", "c")]
    >>> unknown = parameters(oscillator, unknowns)
    >>> rng = np.random.default_rng(0)
    >>> values = np.column_stack([np.zeros(200), rng.standard_normal(200)])
    >>> blank = TimeRecord(10.0, values, ("1X", "1X"), ("acceleration", "force"), variance=[1e-4, 0.0])
    >>> record = simulated_time_record(oscillator, unknown, blank, rng=rng)
    >>> found = identify_time(oscillator, unknown.started_at(np.array([3.0, 40.0, 2.0])), record)
    >>> found.status.value, np.abs(found.values - unknown.start).max() < 0.5
    ('converged', np.True_)
    """
    require_class("structure", structure, Structure, "make it by `Structure(nodes, elements, fixed)`")
    require_class("unknown", unknown, Parameters, "make it by `parameters(structure, unknowns)`")
    require_class("record", record, TimeRecord, "make it by `read_record` or `TimeRecord`")
    chosen = options or TimeOptions()
    if chosen.method == "output_error":
        return identified_by_output_error(structure, unknown, record, chosen, work, progress)
    if "support_acceleration" in record.quantities:
        raise InputError(f"method {chosen.method!r} takes no motion of supports; take 'output_error'")
    if chosen.method == "instrumental":
        return identified_by_instruments(structure, unknown, record, chosen, work)
    return identified_by_weak_form(structure, unknown, record, chosen)
