"""A payload in a file by what it is made from: ``payload = { kind = "box", mass = 2.0, size = [0.4, 0.2, 0.1] }``."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

from coop_pin.description.payload import Payload
from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, Positive, Vector3


class PayloadSource(Description):
    """What a payload is made from. The resolved scenario holds mass, inertia and shape in its place."""

    @abstractmethod
    def build(self) -> Payload:
        """Return the payload."""


class BoxSource(PayloadSource):
    """Arguments of Payload.box."""

    kind: Literal["box"] = "box"
    mass: Positive
    size: Vector3

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.box(self.mass, self.size)


class BarSource(PayloadSource):
    """Arguments of Payload.bar."""

    kind: Literal["bar"] = "bar"
    mass: Positive
    length: Positive
    thickness: Positive = 0.03

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.bar(self.mass, self.length, self.thickness)


class CylinderSource(PayloadSource):
    """Arguments of Payload.cylinder."""

    kind: Literal["cylinder"] = "cylinder"
    mass: Positive
    radius: Positive
    length: Positive

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.cylinder(self.mass, self.radius, self.length)


class MeshSource(PayloadSource):
    """Arguments of Payload.mesh."""

    kind: Literal["mesh"] = "mesh"
    path: str
    mass: Positive | None = None
    density: Positive | None = None
    scale: Positive = 1.0

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.mesh(self.path, self.mass, self.density, self.scale)


class UrdfSource(PayloadSource):
    """Arguments of Payload.from_urdf."""

    kind: Literal["urdf"] = "urdf"
    path: str

    def build(self) -> Payload:
        """Return the payload."""
        return Payload.from_urdf(self.path)


PAYLOAD_SOURCES: Mapping[str, type[PayloadSource]] = MappingProxyType(
    {"box": BoxSource, "bar": BarSource, "cylinder": CylinderSource, "mesh": MeshSource, "urdf": UrdfSource}
)


def built(value: Any) -> Any:
    """Return the payload of a table that has a kind; anything else as it is."""
    if not (isinstance(value, Mapping) and "kind" in value):
        return value
    kind = value["kind"]
    if kind not in PAYLOAD_SOURCES:
        raise FieldError(f"is {kind!r}; it must be one of {list(PAYLOAD_SOURCES)}", "kind")
    return PAYLOAD_SOURCES[kind](**value).build()
