"""Compiled laws: controllers as traced code, the checks of users' laws, and laws as C99.

Open first: ``law_code`` (a controller and the kinematics of its arm, traced), ``support`` (why a scenario
cannot run in a batch), ``c_export`` (the law of one arm as C99, with a self-test; ``c_messages`` what it
tells and hears).

Imports what ``compiled`` imports.
"""
