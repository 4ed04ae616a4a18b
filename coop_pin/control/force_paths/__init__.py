"""Force paths: the ways in which a measured internal wrench reaches a law.

A scenario states a path as ``controller.force_path``. Its files import ``base`` and ``control``:

- ``force_path.py``: the properties of every path, and those by sensors (late, low-pass);
- ``exchanged_wrench.py``: the internal wrench of an arm by messages with the wrenches of all arms;
- ``averaged_wrench.py``: the same over any connected graph, by average consensus;
- ``learned_load.py``: an arm's own wrench less its share of a load that the arms learn together.

The last three are wrappers of an arm's law, see ``law_wrapper.py``.
"""
