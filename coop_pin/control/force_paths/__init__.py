"""Force paths: the ways in which a measured internal wrench reaches a law."""
