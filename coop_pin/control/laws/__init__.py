"""Control laws: each file has the equation of one law, its gains and its controller."""
