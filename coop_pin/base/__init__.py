"""Base: arrays, errors, files, frames and frozen values, which every other package uses.

Open first: ``errors`` (all exceptions and warnings), ``arrays`` (arguments checked by name: type, shape,
sign, pose), ``schema/base`` (frozen, validated class of everything in a scenario).

- ``spatial``: poses, wrenches, task rows, internal wrenches, and the notation.
- ``schema``: fields of a scenario, mistakes in them, changes by dotted path, a user's functions by name.
- Files: ``user_files`` (bounded reading), ``atomic_write``, ``disk_cache`` (traced and compiled code).
- Processes: ``memory`` (what is free), ``limited_process`` (limits for libraries that have none).
- Numbers: ``bisection``.

Imports no other package of coop_pin.
"""

import coop_pin.base.loaded_code  # noqa: F401  notes what is loaded of the user from here on
