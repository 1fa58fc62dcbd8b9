"""Imports the modules that workers need; the fork server (`forked_workers`) imports this module."""

import hapticd.rendering.offline
import hapticd.sweeps.engine
import hapticd.sweeps.measures.registry
import hapticd.sweeps.plan  # noqa: F401
from hapticd.sweeps.worker_check import code_version

# Cached here, so that no worker reads and hashes all files again.
code_version()
