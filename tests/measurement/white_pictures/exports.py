"""What tests take from the generator of white pictures."""

from white_pictures.drawing import draw_light, draw_white
from white_pictures.matching import LatticeError, Matched, compare_lattice, lattice_of, match
from white_pictures.named import NAMED, worked_example
from white_pictures.not_whites import NOT_WHITES
from white_pictures.profiles import Blob, OverlappingDiscs, SoftDisc
from white_pictures.random_specs import random_spec
from white_pictures.spec import Readout, TrueLattice, Truth, WhiteSpec

__all__ = [
    "NAMED",
    "NOT_WHITES",
    "Blob",
    "LatticeError",
    "Matched",
    "OverlappingDiscs",
    "Readout",
    "SoftDisc",
    "TrueLattice",
    "Truth",
    "WhiteSpec",
    "compare_lattice",
    "draw_light",
    "draw_white",
    "lattice_of",
    "match",
    "random_spec",
    "worked_example",
]
