"""`python -m bayesid.cli`."""

import sys

from bayesid.cli import main

if __name__ == "__main__":
    sys.exit(main())
