"""Exit codes of ``coop-pin``."""

OK = 0
FAILED = 1
"""A run diverged, a check found errors, a search found no feasible run, or a file cannot be written."""
BAD_INPUT = 2
NOT_TRUSTWORTHY = 3
"""A run finished, but breached a trust threshold of its scenario."""
DROPPED = 4
"""A run finished and kept its trust thresholds, but its payload dropped."""
INTERRUPTED = 130
OUTPUT_CLOSED = 141
"""The reader of the output has gone, as in ``coop-pin list | head -1``; 128 + SIGPIPE."""
