"""White pictures with a name: like those of known cameras, and the extremes of what is measured."""

from white_pictures.profiles import Blob, OverlappingDiscs, SoftDisc
from white_pictures.spec import Readout, WhiteSpec

# square, 15.4 px, bent by 0.02 px, rounded; the gaps hold a quarter of the light
GUV = WhiteSpec(
    shape=(436, 436),
    pitch=15.402,
    angle=-0.112,
    origin=(3.1, -2.4),
    stretch=4e-4,
    profile=SoftDisc(6.3, 1.1),
    scatter=0.015,
    brightness=0.004,
    corner=0.8,
    slope=0.05,
    slope_angle=70.0,
    rounding=0.35,
    second_stop=1.03,
    halo=0.06,
    halo_length=8.0,
    bend=0.02,
    dead=1,
    readout=Readout(white=9000.0, electrons=6000.0, read_noise=4.0, black=400.0),
)
# square, 27.5 px, sheared, cut to cats' eyes, bent by 0.4 px
ANTLEG = WhiteSpec(
    shape=(820, 980),
    pitch=27.53,
    angle=0.249,
    origin=(-5.0, 8.0),
    stretch=-1.5e-3,
    shear=1e-3,
    profile=SoftDisc(12.0, 1.6),
    aspect=0.02,
    aspect_angle=25.0,
    scatter=0.03,
    brightness=0.007,
    corner=0.61,
    slope=0.03,
    slope_at_corner=0.06,
    rounding=0.2,
    second_stop=1.09,
    halo=0.05,
    halo_length=12.0,
    bend=0.4,
    axis=(300.0, 200.0),
    dead=2,
    half_covered=1,
    readout=Readout(white=30000.0, electrons=12000.0, black=300.0),
)
# square, 17.2 px, 8 bits, cats' eyes to 1.4 and half as dark at the border
SEAURCHIN = WhiteSpec(
    shape=(900, 808),
    pitch=17.2,
    angle=0.178,
    profile=SoftDisc(7.2, 0.9),
    scatter=0.03,
    brightness=0.018,
    corner=0.6,
    slope=0.04,
    slope_angle=-20.0,
    rounding=0.15,
    second_stop=1.4,
    halo=0.05,
    bend=0.24,
    axis=(-250.0, 0.0),
    dead=2,
    half_covered=1,
    readout=Readout(white=170.0, black=4.0, bits=8),
)
# hexagonal, 23.3 px, three kinds of microlens, soft rims
R12 = WhiteSpec(
    shape=(1000, 1200),
    layout="hexagonal along y",
    pitch=23.307,
    angle=0.2,
    profile=SoftDisc(10.9, 1.2),
    kinds=(1.0, 0.985, 1.02),
    scatter=0.02,
    brightness=0.005,
    corner=0.75,
    rounding=0.1,
    halo=0.03,
    bend=0.05,
    readout=Readout(white=3000.0, black=64.0, bits=12),
)
NAMED: dict[str, WhiteSpec] = {
    "GUV-like": GUV,
    "antleg-like": ANTLEG,
    "seaurchin-like": SEAURCHIN,
    "R12-like": R12,
    "worked example F/4": WhiteSpec(
        shape=(2748, 3664), pitch=245.582, profile=OverlappingDiscs(72.16, 23.77), scatter=0.0614
    ),
    "touching": WhiteSpec(
        shape=(700, 900), pitch=27.84386, profile=OverlappingDiscs(12.1, 1.8), angle=1.0
    ),
    "spots of 5.3 px": WhiteSpec(shape=(400, 500), pitch=5.3, angle=7.0, profile=Blob(1.5)),
    "hexagonal spots": WhiteSpec(
        shape=(500, 600), layout="hexagonal along x", pitch=9.7, angle=-12.0, profile=Blob(2.2)
    ),
    "pitch of 480 px": WhiteSpec(
        shape=(2400, 3000), pitch=480.0, angle=-2.0, profile=SoftDisc(190.0, 4.0), rounding=0.2
    ),
    "corners at 5 %": WhiteSpec(
        shape=(1000, 1300), pitch=25.0, angle=0.7, corner=0.05, falloff_power=2.5, scatter=0.02
    ),
    "unlit surrounds": WhiteSpec(shape=(900, 1100), pitch=32.0, angle=1.5, margin=180.0),
    "wide gaps": WhiteSpec(
        shape=(700, 900), layout="hexagonal along y", pitch=60.0, profile=SoftDisc(12.0, 1.0)
    ),
}
