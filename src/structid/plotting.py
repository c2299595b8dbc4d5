"""The `plot_...` methods of structures, identifications and measured modes.

The functions that draw live in `structid.report.plots`, which is loaded by its name when the first picture is asked
for: nothing here, and nothing below, imports it.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw(picture: str, *arguments: Any) -> Figure:
    """The figure that the function called `picture` of `structid.report.plots` draws of `arguments`."""
    figure: Figure = getattr(import_module("structid.report.plots"), picture)(*arguments)
    return figure


class IdentificationPlots:
    """Plots of an identification.

    Each gives a Matplotlib figure (``.savefig("frf.png")``; notebooks show it) and draws on `axes` where these are given:
    one, or a sequence with one for each panel.
    """

    def plot_parameters(self, axes: Axes | None = None) -> Figure:
        """Identified over initial values with their intervals."""
        return draw("parameters", self, axes)

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
        return draw("frf", self, sensor, load, record, axes)

    def plot_residuals(self, record: int = 0, axes: Axes | None = None) -> Figure:
        """Size of the whitened residual over frequency and channel: 1 where the model fits to within the noise."""
        return draw("residuals", self, record, axes)

    def plot_modes(self, mode: int = 0, axes: Axes | Sequence[Axes] | None = None) -> Figure:
        """Shapes of the identified model on its structure, at both ends of their motion.

        Parameters
        ----------
        mode : int
            Number of the mode, from 1; without it the first modes, a panel each.
        axes : matplotlib.axes.Axes or sequence of them, optional

        Raises
        ------
        InputError
            If there is no such mode, or the nodes have no positions.
        """
        return draw("model_shapes", self, mode, axes)

    def plot_frequencies(self, axes: Axes | Sequence[Axes] | None = None) -> Figure:
        """Frequencies and damping ratios of the initial and the fitted model."""
        return draw("modes", self, axes)

    def plot_structure(self, axes: Axes | Sequence[Axes] | None = None) -> Figure:
        """The structure, coloured by the change of its parameters: a panel for each kind of property."""
        return draw("changes", self, axes)

    def plot_correlation(self, axes: Axes | None = None) -> Figure:
        """Plot the correlation matrix of the parameters' errors."""
        return draw("correlation", self, axes)

    def plot_convergence(self, axes: Axes | Sequence[Axes] | None = None) -> Figure:
        """The way of the search: sum of squares and parameters."""
        return draw("convergence", self, axes)


class StructurePlots:
    """Plots of a structure."""

    def plot_structure(self, axes: Axes | None = None) -> Figure:
        """Elements, supports, masses and springs."""
        return draw("structure", self, axes)


class ModesPlots:
    """Plots of measured modes."""

    def plot_stabilization(self, axes: Axes | None = None) -> Figure:
        """Poles over model order, and the modes that were taken.

        Raises
        ------
        InputError
            If the method has no orders to choose among.
        """
        return draw("stabilization", self, axes)

    def plot_modes(self, mode: int = 1, axes: Axes | None = None) -> Figure:
        """The shape of a mode (numbers from 1), at both ends of its motion."""
        return draw("shape", self, mode, axes)
