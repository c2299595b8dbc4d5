"""Linear least squares over records of any length: one pass of bounded memory, a small triangle a block of equations."""

from structid.inversion.regression.block_least_squares import BlockFit, block_solution
from structid.inversion.regression.local_reduction import FoldingKernels
from structid.inversion.regression.streaming_qr import LinearFit, StreamingQr, no_rows

__all__ = ["BlockFit", "FoldingKernels", "LinearFit", "StreamingQr", "block_solution", "no_rows"]
