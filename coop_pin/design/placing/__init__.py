"""Places of a new cell: contacts of the arms around the payload, their bases, and distances between bodies.

Open first: ``contacts`` (where and how each arm takes the payload; shoulders of one robot), ``placement``
(search for the base and the grasp of each arm by its margins; ``tool_axes`` turn its tool), ``workspace`` (of
all), ``drafts`` (cells in these workspaces, those with bodies apart first, and the motions that they may do).

Imports ``base``, ``description``, ``feasibility`` and ``model``.
"""
