"""What the command line remarks on: displays and files that disagree on what values mean."""

from layerfield.display import Display
from layerfield.display_spec import PhysicalSpec
from layerfield.light_field import LightField
from layerfield.transfer import NONE, named


def values_taken_for_light(field: LightField, display: Display) -> list[str]:
    """Remark on 8-bit pictures, hardly ever light, for a real display without transfer."""
    physical = isinstance(display.spec, PhysicalSpec)
    if field.bits != 8 or not physical or display.transfer != NONE:
        return []
    return [
        f"note: display '{display.name}' has no transfer, so the 8-bit values of '{field.name}' "
        'are taken for light; panels that decode them, as monitors do, need transfer = "srgb"'
    ]


def made_for_another_transfer(made_for: Display | None, shown_on: Display) -> list[str]:
    """Remark on layers whose values another display would make other light of."""
    if made_for is None or made_for.transfer == shown_on.transfer:
        return []
    return [
        f"note: the layers were made for panels with transfer {named(made_for.transfer)}, those of "
        f"display '{shown_on.name}' have {named(shown_on.transfer)}: the light is another"
    ]
