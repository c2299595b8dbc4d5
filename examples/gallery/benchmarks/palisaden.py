"""
An eight-storey timber building under wind
==========================================

Palisaden in Ås, Norway: six accelerometers on the top floor, ambient vibration (Aloisio and others 2020, Engineering
Structures 213, 110593; example data of pyOMA2, MIT licence, kept here in half precision). The first quarter of an
hour at 20 Hz is enough for the three lowest modes, which pyOMA2 finds at 1.882, 2.422 and 2.687 Hz in all ninety
minutes. One learns what a quarter of an hour leaves uncertain, above all in the damping.
"""

from pathlib import Path

import structid as sid

path = Path("palisaden.npy")
read = sid.ReadOptions(
    sampling_rate=20.0, channels=("1X-", "1Y-", "2X-", "2Y-", "3X-", "3Y+"), quantities=("acceleration",) * 6
)

# %%
# The modes
# ---------
found = sid.modes_of_file(path, sid.ModesOptions(band=(1.0, 5.0)), read)
modes = found.identification.modes
print(modes)
diagram = found.plot_stabilization()
