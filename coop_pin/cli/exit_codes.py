"""What ``coop-pin`` tells the shell."""

OK = 0
FAILED = 1
"""A run diverged, a check found errors, a search found nothing within its bounds, a file cannot be written."""
BAD_INPUT = 2
INTERRUPTED = 130
