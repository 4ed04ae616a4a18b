"""Places of a new cell: contacts of the arms around the payload, their bases, and distances between bodies.

Open first: ``contacts`` (where and how each arm takes the payload; shoulders of one robot), ``placement``
(search for the base of each arm by its margins, and for a workspace of all), ``drafts`` (cells in these
workspaces, those with bodies apart first, and the motions that they may do).

Imports ``base``, ``control``, ``description``, ``feasibility`` and ``model``.
"""
