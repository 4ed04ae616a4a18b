"""Exit codes of ``coop-pin``."""

OK = 0
FAILED = 1
"""A check found errors, a search found no feasible run, or a file cannot be written."""
BAD_INPUT = 2
NOT_SOUND = 3
"""The simulation of a run breached a trust threshold of its scenario."""
NOT_KEPT = 4
"""A sound run did not keep its task: off its limits, dropped or lost."""
INTERRUPTED = 130
OUTPUT_CLOSED = 141
"""The reader of the output has gone, as in ``coop-pin list | head -1``; 128 + SIGPIPE."""
