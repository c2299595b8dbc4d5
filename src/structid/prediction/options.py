"""Options of `structid predict`, `sense` and `export`, as their flags state them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from structid.core.constraints import Limits, part_of_one, require_band, require_declared, split_commas
from structid.core.errors import InputError

#: Models within the uncertainty behind a band.
N_DRAWS = 400


@dataclass(frozen=True)
class PredictOptions:
    """Options of `structid predict`.

    Parameters
    ----------
    sensors : str
        What is predicted, with commas between: degrees of freedom, `401X+,12Z`; forces at the ends of bars and beams,
        `M[deck:3@12]`; strains and stresses of their fibres, `stress[deck:3@12 y=0.05 E=2.1e11]`; stresses of plates and shells,
        `von_mises[plate:17@top]`.
    loads : str
        Degrees of freedom at which unit forces act, with commas between; those of the measured record by default. A support moves
        by unit acceleration.
    kind : str
        Of the FRFs: receptance, mobility or accelerance; transmissibility where supports move.
    band : tuple of float, optional
        Lowest and highest frequency, Hz; the fitted band by default, that of the study or of its FRFs.
    lines : int
        Number of frequencies.
    history : Path, optional
        File of measured or designed loads, as a record: what they cause from rest is predicted too. Forces act; accelerations and
        displacements at supports move these. Displacements follow a spline through the samples, all else runs in straight lines
        between them, unless `filtered`.
    filtered : bool
        The forces and accelerations of `history` were measured behind a filter against aliasing: they hold all that they had
        below half the sampling rate, which straight lines between samples would weaken. Designed loads, such as pulses and
        steps, are not filtered. Displacements follow their spline in either case.
    half_sine : str
        A half-sine pulse as size, width in s and place, `500,0.01@12Y`: N, or m/s^2 at a support.
    sine : str
        A sine from rest as size, Hz and place, `500,12@12Y`.
    noise : str
        Stationary noise as a table of Hz and one-sided density (N^2/Hz) and a place, `wind.csv@12Y`: spectra, root mean squares and
        the largest within the duration are predicted.
    duration : float, optional
        s, of a half-sine, sine or noise.
    sampling_rate : float, optional
        Samples per second of a half-sine or sine; with `noise` the motion under one sample of it is predicted too.
    supports : str
        Which supports move with one that does, where the study has no base: all in its direction together, or it alone.
    relative : bool
        Motion of a history against supports that move, in place of absolute motion.
    motion : str
        Of histories: displacement, velocity or acceleration; of spectra that of `kind`.
    tune_damper : str
        Mass and place of a tuned mass damper whose frequency and damping are sought, `800@40X`: those with which the largest
        response there within `band` is smallest over the uncertainty. It is then added as the last of the changes.
    modes : int
        Number of natural modes.
    participation : str
        Axes along which the ground moves, with commas between, `X,Y`: participation factors and effective masses of the modes.
    draws : int
        Models within the uncertainty behind each band.
    seed : int
        Of those models.
    """

    sensors: str = ""
    loads: str = ""
    kind: Literal["receptance", "mobility", "accelerance", "transmissibility"] = "accelerance"
    band: tuple[float, float] | None = None
    lines: Annotated[int, Limits(least=2)] = 400
    history: Path | None = None
    filtered: bool = False
    half_sine: str = ""
    sine: str = ""
    noise: str = ""
    duration: Annotated[float, Limits(above=0)] | None = None
    sampling_rate: Annotated[float, Limits(above=0)] | None = None
    supports: Literal["together", "alone"] = "together"
    relative: bool = False
    motion: str = "acceleration"
    tune_damper: str = ""
    modes: Annotated[int, Limits(least=1)] = 8
    participation: str = ""
    draws: Annotated[int, Limits(least=50)] = N_DRAWS
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise `InputError` for an option out of its limits, or options that exclude each other or lack others.

        A band must rise from above 0 Hz, `participation` name each of X, Y and Z once at most, only one of `history`,
        `half_sine` and `sine` be given, and loads that are made have a duration and a sampling rate.
        """
        require_declared(self)
        if self.band is not None:
            require_band("band", self.band, is_zero_allowed=False, is_open_allowed=False)
        axes = split_commas(self.participation)
        if not set(axes) <= {"X", "Y", "Z"} or len(set(axes)) < len(axes):
            raise InputError(
                f"`participation` must name axes of the ground's motion, as X,Y, each once, got {self.participation!r}",
                "participation",
            )
        loads = [name for name in ("history", "half_sine", "sine") if getattr(self, name)]
        if len(loads) > 1:
            raise InputError(
                f"give one of `history`, `half_sine` and `sine`, got {' and '.join(f'`{name}`' for name in loads)}",
                loads[1],
            )
        if self.filtered and self.history is None:
            raise InputError(
                "`filtered` must be left out without `history`, whose loads it is about; got True", "filtered"
            )
        for name in ("sampling_rate",) if self.noise else ("sampling_rate", "duration"):
            if self.history is not None and getattr(self, name) is not None:
                raise InputError(
                    f"`{name}` must be left out with `history`, whose file states it; got {getattr(self, name):g}", name
                )
        needed = {
            "half_sine": ("duration", "sampling_rate"),
            "sine": ("duration", "sampling_rate"),
            "noise": ("duration",),
        }
        for name, others in needed.items():
            for other in others if getattr(self, name) else ():
                if getattr(self, other) is None:
                    raise InputError(f"`{other}` must be given with `{name}`", other)


@dataclass(frozen=True)
class SenseOptions:
    """Options of `structid sense`.

    Parameters
    ----------
    wanted : str
        Degrees of freedom whose motion is wanted, and forces and stresses of elements as for `structid predict`, with commas
        between.
    motion : str
        displacement, velocity or acceleration.
    unknown : str
        Degrees of freedom at which forces act that were not measured, with commas between.
    correlation_time : float, optional
        Correlation time of these forces, s; the likeliest by default.
    force_std : float, optional
        Standard deviation of these forces, N; the likeliest by default.
    leave_out : str
        Sensors that are not used but compared, with commas between.
    draws : int
        Models within the uncertainty.
    unfiltered : bool
        No filter against aliasing acted on the record, as on simulated ones; records are taken as filtered by default.
    """

    wanted: str = ""
    motion: str = "displacement"
    unknown: str = ""
    correlation_time: float | None = None
    force_std: float | None = None
    leave_out: str = ""
    draws: Annotated[int, Limits(least=0)] = 20
    unfiltered: bool = False

    def __post_init__(self) -> None:
        require_declared(self)


@dataclass(frozen=True)
class ExportOptions:
    """Options of `structid export`.

    Parameters
    ----------
    modes : int
        Number of natural modes in files of modes and grids.
    sensors : str
        Degrees of freedom of the outputs of state equations, with commas between.
    loads : str
        Degrees of freedom of the inputs of state equations, with commas between.
    band : tuple of float, optional
        Lowest and highest frequency, Hz, in which the equations hold.
    motion : str
        Of the outputs: displacement, velocity or acceleration.
    order : int, optional
        Number of states; the fewest that keep to `error` by default.
    error : str
        Largest error of FRFs in the band, in parts of the largest: `1%` or `0.01`.
    sampling_rate : float, optional
        Equations from sample to sample; continuous time by default.
    draws : int
        Models within the uncertainty whose equations are written too.
    """

    modes: Annotated[int, Limits(least=1)] = 10
    sensors: str = ""
    loads: str = ""
    band: tuple[float, float] | None = None
    motion: str = "acceleration"
    order: int | None = None
    error: str = "1%"
    sampling_rate: float | None = None
    draws: Annotated[int, Limits(least=0)] = 0

    def __post_init__(self) -> None:
        """Raise `InputError` for an option out of its limits, or an error that is no part of 1."""
        require_declared(self)
        _ = self.largest_error

    @property
    def largest_error(self) -> float:
        """`error` as a number: 0.01 of ``1%``; `InputError` unless it lies between 0 and 1."""
        part = part_of_one(self.error)
        if not 0 < part < 1:
            raise InputError(f"`error` must be a part of 1, as 1% or 0.01, got {self.error!r}", "error")
        return part
