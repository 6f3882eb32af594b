"""The properties that a verdict judges, as people read them."""

PROPERTY_NAMES = {
    "mtf": "contrast (MTF)", "views": "number of views",
    "micro_images_mm": "micro-images: fields and pitch",
    "overlap_mm": "overlap", "depth_of_field_mm": "depth of field", "light": "marginal light",
    "elr_row_px": "effective lateral resolution",
    "dot_distance_mm": "depth of the dots", "map_distance_mm": "distance of the depth map",
    "target_image": "image of the target: size and roll",
    "array_attitude_mrad": "tilt and roll of the array",
    "noise": "noise of the camera",
}  # fmt: skip
