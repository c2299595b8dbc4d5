"""Pictures of answers by Matplotlib, as methods: the one door through which lower floors reach the drawing, when asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from structid.fem import Structure
    from structid.identification.identified import Identification
    from structid.modal.survey.survey import ModesResult


class IdentificationPlots:
    """What can be drawn of an identification.

    Each gives a Matplotlib figure (``.savefig("frf.png")``; notebooks show it) and draws on `axes` where these are given:
    one, or a sequence with one for each panel.
    """

    def plot_parameters(self, axes: Axes | None = None) -> Figure:
        """Identified over initial values with their intervals."""
        from structid.report.plots import parameters

        return parameters(self._own(), axes)

    def plot_frf(
        self, sensor: str = "", load: str = "", record: int = 0, axes: Axes | Sequence[Axes] | None = None
    ) -> Figure:
        """Measured, initial and fitted response of a channel: magnitude, phase, and coherence where it was measured.

        Parameters
        ----------
        sensor, load : str
            Such as ``"3X"``; without them the channel that is fitted worst.
        record : int
            Position of the record.
        axes : matplotlib.axes.Axes or sequence of them, optional
            For the magnitude, and for what comes below it.

        Raises
        ------
        InputError
            If there is no such record or channel.
        """
        from structid.report.plots import frf

        return frf(self._own(), sensor, load, record, axes)

    def plot_residuals(self, record: int = 0, axes: Axes | None = None) -> Figure:
        """Size of the whitened residual over frequency and channel: 1 where the model fits to within the noise."""
        from structid.report.plots import residuals

        return residuals(self._own(), record, axes)

    def plot_modes(self, axes: Axes | Sequence[Axes] | None = None) -> Figure:
        """Frequencies and damping ratios of the initial and the fitted model."""
        from structid.report.plots import modes

        return modes(self._own(), axes)

    def plot_structure(self, axes: Axes | Sequence[Axes] | None = None) -> Figure:
        """The structure, coloured by the change of its parameters: a panel for each kind of property."""
        from structid.report.plots import changes

        return changes(self._own(), axes)

    def plot_correlation(self, axes: Axes | None = None) -> Figure:
        """How the errors of the parameters go together."""
        from structid.report.plots import correlation

        return correlation(self._own(), axes)

    def plot_convergence(self, axes: Axes | Sequence[Axes] | None = None) -> Figure:
        """The way of the search: sum of squares and parameters."""
        from structid.report.plots import convergence

        return convergence(self._own(), axes)

    def _own(self) -> Identification:
        return cast("Identification", self)


class StructurePlots:
    """What can be drawn of a structure."""

    def plot_structure(self, axes: Axes | None = None) -> Figure:
        """Elements, supports, masses and springs."""
        from structid.report.plots import structure

        return structure(cast("Structure", self), axes)


class ModesPlots:
    """What can be drawn of measured modes."""

    def plot_stabilization(self, axes: Axes | None = None) -> Figure:
        """Poles over model order, and the modes that were taken.

        Raises
        ------
        InputError
            If the method has no orders to choose among.
        """
        from structid.report.plots import stabilization

        return stabilization(cast("ModesResult", self), axes)

    def plot_modes(self, mode: int = 1, axes: Axes | None = None) -> Figure:
        """The shape of a mode (numbers from 1), at both ends of its motion."""
        from structid.report.plots import shape

        return shape(cast("ModesResult", self), mode, axes)
