"""`python -m hapticd` is the command `hapticd`."""

import sys

from hapticd.cli import main

sys.exit(main())
