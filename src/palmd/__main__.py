"""`python -m palmd`: the same as the `palmd` command."""

import sys

from palmd.cli import main

if __name__ == "__main__":
    sys.exit(main())
