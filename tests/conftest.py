"""Set up for every test: nothing random from run to run in CI, no window, nothing that depends on load."""

import os

from hypothesis import HealthCheck, settings

# Before anything imports matplotlib.
os.environ["MPLBACKEND"] = "Agg"

# Deadlines and `too_slow` would test the machine's load. CI repeats its examples, others try new ones.
_CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("local", _CALM)
settings.register_profile("ci", _CALM, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")
