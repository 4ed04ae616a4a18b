"""Compiled laws: controllers as traced code, checks of users' laws, and export as C99."""
