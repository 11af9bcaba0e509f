"""Entry point of `python -m tools.tabletop`; see `kit`."""

import sys

from tools.tabletop.kit import main

sys.exit(main(sys.argv[1:]))
