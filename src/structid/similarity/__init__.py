"""Similarity and pairing of two sets of mode shapes or response functions: pure functions of arrays."""

from structid.similarity.pairing import Pairing as Pairing
from structid.similarity.pairing import pair_modes as pair_modes
from structid.similarity.responses import fdac as fdac
from structid.similarity.responses import frac as frac
from structid.similarity.shapes import comac as comac
from structid.similarity.shapes import ecomac as ecomac
from structid.similarity.shapes import mac as mac
from structid.similarity.shapes import most_real as most_real
from structid.similarity.shapes import orthogonality as orthogonality
from structid.similarity.shapes import subspace_angles as subspace_angles
