"""
A measured frame of three storeys
=================================

Four aluminium plates on twelve columns, slid on rails by a shaker (measured at IQS, Barcelona; data of pymodal, MIT
licence). Masses, column stiffnesses, rails and dampers come out, and the answer says plainly what the model does not
explain. One learns what a real record looks like beside a simulated one. The study is told step by step in
:doc:`/three-storey-frame`.
"""

from pathlib import Path

import structid as sid

study = sid.load_study(Path("../../three_storey_frame/study.toml"))
structure = study.structure.plot_structure()

# %%
# The answer
# ----------
found = sid.run_study(study).identification
print(found.estimate)
fit = found.plot_frf("401X")
changes = found.plot_structure()
