"""What a bench file states about metal, glass and the gaps kept between them."""

from typing import Annotated

from pydantic import Field

from flflab.description import Description, Length


class EnvelopeDescription(Description):
    """How far metal and glass stand out of the plane that an element's place names: towards the
    target and away from it.
    """

    front: Annotated[Length, Field(ge=0)] = 0.0
    rear: Annotated[Length, Field(ge=0)] = 0.0


class ArrayEnvelopeDescription(EnvelopeDescription):
    """The same of the array's holder, and how far it reaches from the main axis."""

    radius: Annotated[Length, Field(ge=0)] = 0.0


class EnvelopesDescription(Description):
    """Of what stands on the axis: about the principal plane, the microlenses' and the pixels'."""

    target: EnvelopeDescription = EnvelopeDescription()
    main_lens: EnvelopeDescription = EnvelopeDescription()
    array: ArrayEnvelopeDescription = ArrayEnvelopeDescription()
    sensor: EnvelopeDescription = EnvelopeDescription()


class MinimumGaps(Description):
    """The smallest gap allowed between neighbours, from metal to metal; one number is for array and
    sensor.

    Main lens and array are kept as far apart as array and sensor unless stated; target and main
    lens only where stated.
    """

    array_sensor: Annotated[Length, Field(gt=0)] = Field(alias="array-sensor")
    lens_array: Annotated[Length, Field(gt=0)] | None = Field(None, alias="lens-array")
    target_lens: Annotated[Length, Field(gt=0)] | None = Field(None, alias="target-lens")


def of_array_and_sensor(given: object) -> object:
    """A single gap is that of array and sensor."""
    return given if isinstance(given, dict) else {"array-sensor": given}
