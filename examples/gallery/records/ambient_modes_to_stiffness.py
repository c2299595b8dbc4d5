"""
Ambient modes: ratios of stiffness to mass, and kilograms by a weighed mass
===========================================================================

Without a measured force, modes tell ratios only. With the floors weighed, the modes of a four-storey frame give the
stiffness of each storey in N/m; without, the answer says what remains determined. One learns why a common scale is
free, and what fixes it.
"""

from pathlib import Path

import structid as sid

study = sid.load_study(Path("../../ambient_storeys/study.toml"))

# %%
# With weighed floors
# -------------------
found = sid.run_study(study).identification
print(found.estimate)
figure = found.plot_structure()

# %%
# With masses unknown too
# -----------------------
unknown = [sid.Unknown("mass", "floor", each=True), sid.Unknown("stiffness", "storey", each=True)]
both = sid.parameters(study.structure, unknown)
free = sid.identify_together([sid.ModalSetup(study.structure, both, found.setups[0].record)])
print("status:", free.estimate.status.value)
ratios = free.mass.ratios
print(ratios.words)
for name, value, std in zip(ratios.names, ratios.values, ratios.std, strict=True):
    print(f"{name} / {ratios.reference}: {value:.5g} ± {std:.2g}")
