"""``python -m sayd_env`` is ``sayd``."""

import sys

from sayd_env.cli import main

if __name__ == "__main__":
    sys.exit(main())
