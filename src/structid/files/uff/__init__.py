"""Universal files: their datasets as text, units (164), and nodes with their coordinate systems (15, 18, 781, 2411, 2420)."""

from structid.files.uff.datasets import UffDataset, UnitFactors, dataset_lines, read_blocks, read_unit_factors
from structid.files.uff.nodes import UniversalNodes, read_nodes

__all__ = [
    "UffDataset",
    "UnitFactors",
    "UniversalNodes",
    "dataset_lines",
    "read_blocks",
    "read_nodes",
    "read_unit_factors",
]
