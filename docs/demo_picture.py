"""`python docs/demo_picture.py`: identifies the measured frame and draws the picture of README and landing page."""

from __future__ import annotations

from pathlib import Path

import structid as sid
from structid.report.figures.responses import extremes_figure
from structid.report.rendering.png import plotted

HERE = Path(__file__).parent
STUDY = HERE.parent / "examples" / "three_storey_frame" / "study.toml"


def main() -> None:
    """Write docs/images/demo.png: measured, initial and fitted response of the worst and the best channel."""
    result = sid.run_study(sid.load_study(STUDY))
    figure = plotted(extremes_figure(result.identification.fits[0]), None)
    figure.savefig(HERE / "images" / "demo.png", dpi=110)
    print(result.view.headline)


if __name__ == "__main__":
    main()
