"""What tests take from the generator of white pictures."""

from white_pictures.drawing import draw_light, draw_white
from white_pictures.matching import compare_lattice, match
from white_pictures.named import NAMED
from white_pictures.not_whites import NOT_WHITES
from white_pictures.profiles import Blob, OverlappingDiscs, SoftDisc
from white_pictures.random_specs import random_spec
from white_pictures.spec import Readout, WhiteSpec

__all__ = [
    "NAMED",
    "NOT_WHITES",
    "Blob",
    "OverlappingDiscs",
    "Readout",
    "SoftDisc",
    "WhiteSpec",
    "compare_lattice",
    "draw_light",
    "draw_white",
    "match",
    "random_spec",
]
