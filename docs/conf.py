"""Settings of Sphinx for the site of the documentation, which `make docs` builds into build/site.

The pages are Markdown (MyST) that is also readable on a code host. A heading of level three in glossary.md is a term,
to which {term}`...` in a page leads.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from docutils import nodes
from pydantic import BaseModel
from sphinx.application import Sphinx

import hapticd

project = "hapticd"
author = "The hapticd authors"
release = hapticd.__version__
html_title = f"hapticd {release}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click"]
myst_heading_anchors = 4
myst_enable_extensions = ["attrs_inline"]
exclude_patterns = ["*.py", "vendor"]
# Docstrings are written with single backticks around code.
default_role = "code"
nitpicky = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_inherit_docstrings = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_favicon = "images/favicon.svg"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False


def add_terms(app: Sphinx, doctree: nodes.document) -> None:
    """Make a term of each heading of level three in the glossary."""
    docname = app.env.current_document.docname
    if docname != "glossary":
        return
    for section in doctree.findall(nodes.section):
        if isinstance(section.parent.parent, nodes.section):
            app.env.domains.standard_domain._note_term(section[0].astext(), section["ids"][0], section)


def shorten(
    app: Sphinx, what: str, name: str, obj: object, options: object, signature: str | None, returns: str | None
) -> tuple[str, None] | None:
    """Leave out the signature of a class that nobody calls by position: a model, a mapping, an enumeration."""
    if what == "class" and issubclass(obj, BaseModel | dict | Enum | np.ndarray):
        return "", None
    return None


def setup(app: Sphinx) -> None:
    """Connect the hooks; Sphinx calls it."""
    app.connect("doctree-read", add_terms)
    app.connect("autodoc-process-signature", shorten)
