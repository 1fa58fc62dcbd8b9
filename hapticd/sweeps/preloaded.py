"""Imported by the process that workers are forked from (`forked_workers`): what they need for a piece of a sweep."""

import hapticd.rendering.offline
import hapticd.sweeps.engine
import hapticd.sweeps.measures.registry
import hapticd.sweeps.plan  # noqa: F401
from hapticd.sweeps.worker_check import code_version

# Known from here on, so that no worker reads all files again.
code_version()
