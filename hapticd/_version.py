"""The package's version; pyproject.toml reads it from here. The protocol has a version of its own."""

__version__ = "0.1.0"
