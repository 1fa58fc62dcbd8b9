"""The package's version; pyproject.toml reads it from here. The protocol has a separate version."""

__version__ = "0.1.0"
