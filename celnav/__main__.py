"""``python -m celnav``."""

import sys

from celnav.cli import main

sys.exit(main())
