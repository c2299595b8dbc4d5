"""
A beam with six masses that lose weight
=======================================

A cantilever of 0.38 m with six small masses (Zenodo record 8081690, de Sousa and Machado 2024), healthy and with up
to 8.9 % of the mass lost. Their places scatter by as much as one step of damage moves the resonances. One learns to
look at the scatter before looking for damage; :doc:`/six-masses` goes on. The record is not part of structid:
download it and name the folder that holds ``beam_six_masses_frf/frf.npz`` in ``STRUCTID_DATA``.
"""

import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

path = Path(os.environ.get("STRUCTID_DATA", ".")) / "beam_six_masses_frf" / "frf.npz"


def pictured(data):
    """Responses of all arrangements around the fourth and fifth resonance."""
    picture = Figure(figsize=(7, 3.4), layout="constrained")
    axes = picture.subplots()
    lines = data["freq_hz"]
    shown = (lines > 700) & (lines < 1250)
    for state, color in (("healthy", "tab:blue"), ("d887", "tab:red")):
        levels = data[state][:, shown, 0].T
        axes.plot(lines[shown], levels, color=color, lw=0.5, label=[state] + [None] * (levels.shape[1] - 1))
        peaks = [lines[shown][np.argmax(np.where(lines[shown] < 950, level, -999))] for level in levels.T]
        print(f"{state}: fourth resonance {np.mean(peaks):.1f} Hz, scatter {np.std(peaks):.1f} Hz")
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("level (dB)")
    axes.legend(frameon=False)
    return picture


if path.exists():
    figure = pictured(np.load(path))
else:
    print(f"skipped: {path} is not there; see above where to get it")
