"""`python -m palmd`: the same as the `palmd` command."""

import sys

from palmd.console.parent import end_with_parent

if __name__ == "__main__":
    end_with_parent()
    from palmd.cli import main

    sys.exit(main())
