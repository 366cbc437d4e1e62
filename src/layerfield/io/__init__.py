"""Light fields in, pictures out."""

from layerfield.io.animated import refuse_animation, write_animation
from layerfield.io.contact_sheet import contact_sheet, is_contact_sheet, write_contact_sheet
from layerfield.io.images import read_image, write_png
from layerfield.io.loading import field_name, load_eye_views, load_light_field
from layerfield.io.options import Crop, FieldOptions, Order, Quilt
from layerfield.io.safe_output import refuse_existing, whole_directory, whole_file

__all__ = [
    "Crop",
    "FieldOptions",
    "Order",
    "Quilt",
    "contact_sheet",
    "field_name",
    "is_contact_sheet",
    "load_eye_views",
    "load_light_field",
    "read_image",
    "refuse_animation",
    "refuse_existing",
    "whole_directory",
    "whole_file",
    "write_animation",
    "write_contact_sheet",
    "write_png",
]
