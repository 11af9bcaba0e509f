"""`python -m tools.studies NAME …`, in a checkout."""

import sys

from tools.studies.commands import main

if __name__ == "__main__":
    sys.exit(main())
