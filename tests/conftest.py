"""Set up for every test: nothing random from run to run in CI, no window, no deadline."""

import os

from hypothesis import settings

# Before anything imports matplotlib.
os.environ["MPLBACKEND"] = "Agg"

# A deadline would test the machine's load. CI repeats the same examples; a developer's run looks for new ones.
settings.register_profile("local", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")
