"""Control laws: each file has the equation of one law, its gains, its controller and its description.

A law is three classes: gains (``Gains``), a controller of one arm (``LawController``: equation, ``init``,
``step``) and the law as a scenario states it (``DecentralisedLaw``: ``kind``, ``gains``, ``controller_of``).
Open first:

- ``sliding_mode.py``: the printed law of the paper, and the file to copy from;
- ``payload_space_controller.py``: the law on the payload, composed of ``anchored_integral.py``,
  ``bounded_anchor.py`` and a posture; its description, with all fields, is ``payload_space.py``;
- ``leader_follower.py``: the shortest law with a wrist sensor.

They import ``base`` and other files of ``control``; laws with a model of the robot are in ``model_based``.
"""
