"""What all tests share."""

import signal

# A shell starts background jobs with Ctrl-C ignored, and children inherit that; several tests send it to
# children.
signal.signal(signal.SIGINT, signal.default_int_handler)
