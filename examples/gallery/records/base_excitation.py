"""
Shaken by its base: a building on a table
=========================================

No force is measured: the acceleration of the table takes its place. With weighed floors the record gives storey
stiffnesses and dampings in their units; without, it gives their ratios to mass. One learns to declare what the table
moves, as ``[[structure.base]]``, and to fit the histories themselves.
"""

from pathlib import Path

import structid as sid

study = sid.load_study(Path("../../shaken_building/study.toml"))
found = sid.run_study(study).identification
print(found.estimate)
figure = found.plot_frf()
