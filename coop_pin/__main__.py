"""``python -m coop_pin`` is ``coop-pin``."""

import sys

from coop_pin.cli import main

sys.exit(main())
