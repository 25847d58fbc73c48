"""Local elements: springs, dampers, friction, contacts and attachments that act along one direction of the structure.

Each stands in one place with its section of the rig file, which builds it, and its formulas (see element.py).
"""

from typing import Annotated, get_args

from pydantic import Field

from nmt_rig.model.local_elements.attachments import AnyAttachment
from nmt_rig.model.local_elements.contacts import AnyContact
from nmt_rig.model.local_elements.dampers import AnyDamper
from nmt_rig.model.local_elements.element import ElementSection, LocalElement
from nmt_rig.model.local_elements.friction import AnyFriction
from nmt_rig.model.local_elements.iwan import IwanSection
from nmt_rig.model.local_elements.springs import AnySpring

AnyElement = Annotated[
    AnySpring | AnyDamper | AnyFriction | IwanSection | AnyContact | AnyAttachment, Field(discriminator="kind")
]
SECTIONS: tuple[type[ElementSection], ...] = get_args(
    AnySpring | AnyDamper | AnyFriction | IwanSection | AnyContact | AnyAttachment
)
ELEMENTS: tuple[type[LocalElement], ...] = tuple(
    section.element for section in get_args(AnySpring | AnyDamper | AnyFriction | AnyContact)
)
