"""Schema: the frozen, validated values that a scenario is made of.

Open first: ``base`` (class ``Description`` and the types of fields), ``validation_errors`` (what is wrong
with a field, by the path that the user wrote), ``pose`` (a pose as xyz and rpy).

- ``parts`` and ``changes``: copies with other parts by dotted path, and differences as text.
- ``meanings``: the meaning of each field, read from docstrings.
- ``user_code``: a user's function or class by its name ``module:name``.

Imports ``errors``, ``arrays`` and ``spatial`` of ``base``.
"""
