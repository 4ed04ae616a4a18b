"""What goes on, but is not as the user may think."""

from __future__ import annotations


class UrdfWarning(UserWarning):
    """A robot description file whose masses or inertias no body can have, or whose numbers look like another unit's."""


class GeometryWarning(UserWarning):
    """A visual geometry that cannot be read and is left out of pictures; the physics does not use it."""


class ViewWarning(UserWarning):
    """A 3-D view that does not show, or no longer; the simulation goes on without it."""
