"""Live view: a run that is drawn while it is computed, its server, and the Jupyter panel."""
