"""Frozen pydantic base of everything in a scenario file: fields, validation errors, overrides, poses."""
