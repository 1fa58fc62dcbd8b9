"""Settings of Sphinx for the documentation as a site, which `make docs` builds into build/site.

The pages are Markdown that a code host displays as well. {term}`...` in a page leads to a heading of glossary.md.
"""

from __future__ import annotations

import re
from enum import Enum

import numpy as np
from docutils import nodes
from pydantic import BaseModel
from sphinx.application import Sphinx

import hapticd

project = "hapticd"
release = hapticd.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click"]
exclude_patterns = ["*.py"]

# Links to headings work as on a code host: #the-heading.
myst_heading_anchors = 4

# Docstrings have single backticks around code.
default_role = "code"
autodoc_member_order = "bysource"
# Types that are shown by their names, because what they stand for fills lines.
autodoc_type_aliases = {
    name: name.removeprefix("npt.") for name in ("npt.ArrayLike", "ConfigSource", "SceneSource", "Samples", "Json")
}
python_maximum_signature_line_length = 90
toc_object_entries = False

html_title = f"hapticd {release}"
html_theme = "furo"
html_favicon = "images/favicon.svg"
html_copy_source = False
html_show_copyright = False
html_use_index = False
# Summaries would have to be fetched, which a browser refuses if the site was opened from files.
html_show_search_summary = False


def add_terms(app: Sphinx, doctree: nodes.document) -> None:
    """Make a term of each heading of level three in the glossary."""
    if app.env.current_document.docname == "glossary":
        for section in doctree.findall(nodes.section):
            if isinstance(section.parent.parent, nodes.section):
                app.env.domains.standard_domain._note_term(section[0].astext(), section["ids"][0], section)


def shorten_signature(
    app: Sphinx, what: str, name: str, obj: type, options: object, arguments: str | None, result: str | None
) -> tuple[str, str | None] | None:
    """Return the signature with type aliases by their names, and none of a class that nobody calls by position."""
    if what == "class" and issubclass(obj, BaseModel | dict | Enum | np.ndarray):
        return "", None
    plain = [text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (arguments, result)]
    return plain[0] and (plain[0], plain[1])


def setup(app: Sphinx) -> None:
    """Connect the functions above; Sphinx calls it."""
    app.connect("doctree-read", add_terms)
    app.connect("autodoc-process-signature", shorten_signature)
