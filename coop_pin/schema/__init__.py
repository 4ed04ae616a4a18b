"""Base of the configuration classes: frozen, validated, overridable by dotted path; and the Pose value."""
