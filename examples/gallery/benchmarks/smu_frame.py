"""
A four-storey laboratory frame of Georgia Tech
==============================================

Modes of a shear frame on a shake table with weighed floors (Structural Model Updating, SMU). Its authors update the
storey stiffnesses from two modes at three floors and publish two answers that differ by up to 7 %. One learns that
intervals say which of such differences matter. The data are under GPL-3.0 and not part of structid: put
``Examples/FourStoryStructure`` of github.com/ywang-structures/Structural-Model-Updating as
``four_story_lab_frame.npz`` (arrays ``test_frequency_hz``, ``test_mode``) into a folder and name that in
``STRUCTID_DATA``.
"""

import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import structid as sid

path = Path(os.environ.get("STRUCTID_DATA", ".")) / "smu_shear_frames" / "four_story_lab_frame.npz"
newton_per_meter = 4.4482216 / 0.0254  # of lbf/in
published = {"by MAC": [7.397, 7.841, 8.717, 15.327], "by eigenvectors": [7.523, 7.311, 8.812, 15.775]}
here, below = [f"{i}X" for i in range(1, 5)], [f"{i}X" for i in range(4)]


def identified(data):
    """Modes 1 and 2 at floors 1 to 3; springs start at 10 lbf/in."""
    parts = [
        sid.PointMass("floor", [1, 2, 3, 4], 12.060 * 0.45359237),
        sid.Spring("storey", below, here, stiffness=10 * newton_per_meter),
    ]
    frame = sid.Structure({i: 0.3 * i for i in range(5)}, parts, ["0X"], active=["X"])
    shapes = data["test_mode"][:3, :2]
    record = sid.ModalRecord(data["test_frequency_hz"].ravel()[:2], np.full(2, 0.01), shapes, tuple(here[:3]))
    settings = sid.ModalSettings(frequency_error=0.003, shape_error=0.02)
    unknown = sid.parameters(frame, [sid.Unknown("stiffness", "storey", each=True)])
    found = sid.identify_together([sid.ModalSetup(frame, unknown, record, settings)]).estimate
    print("storey stiffness, lbf/in: found (95 %), published by MAC and by eigenvectors")
    for value, ends, *others in zip(found.values, found.interval(0.95), *published.values(), strict=True):
        low, high = ends / newton_per_meter
        print(f"{value / newton_per_meter:8.2f} ({low:.2f} to {high:.2f})  {others[0]:8.2f} {others[1]:8.2f}")
    return found


def pictured(found):
    """Storey by storey, with 95 % intervals."""
    picture = Figure(figsize=(7, 3), layout="constrained")
    axes = picture.subplots()
    value, ends = found.values / newton_per_meter, found.interval(0.95) / newton_per_meter
    axes.errorbar(
        range(1, 5), value, [value - ends[:, 0], ends[:, 1] - value], fmt="ko", capsize=4, label="found, 95 %"
    )
    for mark, (way, stiffness) in zip("_x", published.items(), strict=True):
        axes.plot(range(1, 5), stiffness, mark, ms=9, label=f"published, {way}")
    axes.set_xticks(range(1, 5))
    axes.set_xlabel("storey")
    axes.set_ylabel("stiffness (lbf/in)")
    axes.legend(frameon=False)
    return picture


# %%
# The answer, where the data are
# ------------------------------
if path.exists():
    found = identified(np.load(path))
    figure = pictured(found)
else:
    print(f"skipped: {path} is not there; see above where to get it")
