"""The quantities of a comparison in words, each in the unit that people read it in."""

from typing import NamedTuple

from flflab.property_names import PROPERTY_NAMES


class Quantity(NamedTuple):
    """What a quantity is called, its unit ("" for none), and how many of it the unit of
    ``comparison.csv`` holds.
    """

    words: str
    unit: str = ""
    many: float = 1.0


UM, PERCENT = ("\u00b5m", 1e3), ("%", 100.0)
PANELS = {  # drawn small, one panel each
    "bright_field_mm": Quantity("bright field", *UM),
    "total_field_mm": Quantity("total field", *UM),
    "image_pitch_mm": Quantity("pitch of the micro-images", *UM),
    "overlap_mm": Quantity(PROPERTY_NAMES["overlap_mm"], *UM),
    "dot_distance_mm": Quantity(PROPERTY_NAMES["dot_distance_mm"], "mm"),
    "map_distance_mm": Quantity(PROPERTY_NAMES["map_distance_mm"], "mm"),
    "elr_row_px": Quantity(PROPERTY_NAMES["elr_row_px"], "px"),
    "light": Quantity(PROPERTY_NAMES["light"], *PERCENT),
    "depth_of_field_near_mm": Quantity("depth of field, near end", "mm"),
    "depth_of_field_far_mm": Quantity("depth of field, far end", "mm"),
    "array_roll_mrad": Quantity("roll of the array", "mrad"),
    "array_yaw_mrad": Quantity("yaw of the array (tilt along x)", "mrad"),
    "array_pitch_mrad": Quantity("pitch of the array (tilt along y)", "mrad"),
    "dot_scale": Quantity("size of the dots' image", *PERCENT),
    "bar_scale": Quantity("size of the bars' image", *PERCENT),
    "target_roll_mrad": Quantity("roll of the target", "mrad"),
    "noise": Quantity("noise over what the camera states", *PERCENT),
}
OTHERS = {
    "views": Quantity(PROPERTY_NAMES["views"]),
    "mtf": Quantity(PROPERTY_NAMES["mtf"]),
    "mtf_y": Quantity(f"{PROPERTY_NAMES['mtf']} of bars along y"),
    "contrast_paper": Quantity("contrast read off pixels, eq. (2)"),
    "ratio_mtf": Quantity("ratio of contrasts (MTF)"),
    "ratio_mtf_y": Quantity("ratio of contrasts (MTF) of bars along y"),
}


def quantity_of(name: str) -> Quantity:
    """A quantity of ``comparison.csv``; a difference to the reference says so."""
    if name.startswith("difference_"):
        whole = quantity_of(name.removeprefix("difference_"))
        return whole._replace(words=f"{whole.words}: difference")
    return {**PANELS, **OTHERS}.get(name, Quantity(name))
