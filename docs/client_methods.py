"""The methods of the clients for the page Python: an extension of Griffe, which mkdocs.yml names.

Griffe reads the code without running it. The blocking client's methods are made when its module is imported, of the
coroutines in hapticd/client/methods.py; without this their signatures and docstrings would be missing.
"""

from __future__ import annotations

import importlib
import inspect
from typing import Any

import griffe

MADE_BY = ("_method(", "_block(", "_subscription(", "_like(")
KINDS = {
    inspect.Parameter.POSITIONAL_ONLY: griffe.ParameterKind.positional_only,
    inspect.Parameter.POSITIONAL_OR_KEYWORD: griffe.ParameterKind.positional_or_keyword,
    inspect.Parameter.VAR_POSITIONAL: griffe.ParameterKind.var_positional,
    inspect.Parameter.KEYWORD_ONLY: griffe.ParameterKind.keyword_only,
    inspect.Parameter.VAR_KEYWORD: griffe.ParameterKind.var_keyword,
}


def annotation(given: object) -> str | None:
    """As it is written in the code; None where there is none."""
    if given is inspect.Signature.empty:
        return None
    return given if isinstance(given, str) else inspect.formatannotation(given)


def parameter(given: inspect.Parameter) -> griffe.Parameter:
    """Griffe's form of a parameter."""
    default = None if given.default is inspect.Parameter.empty else repr(given.default)
    return griffe.Parameter(
        given.name, annotation=annotation(given.annotation), kind=KINDS[given.kind], default=default
    )


class ClientMethods(griffe.Extension):
    """Replaces attributes of a class that are methods once the module is imported."""

    def on_class(self, *, cls: griffe.Class, **kwargs: Any) -> None:
        if not cls.path.startswith("hapticd.client.blocking."):
            return
        made = [
            each
            for each in cls.members.values()
            if isinstance(each, griffe.Attribute) and str(each.value).startswith(MADE_BY)
        ]
        for attribute in made:
            runtime = getattr(importlib.import_module(cls.module.path), cls.name)
            method = getattr(runtime, attribute.name)
            signature = inspect.signature(method)
            function = griffe.Function(
                attribute.name,
                parameters=griffe.Parameters(*map(parameter, signature.parameters.values())),
                returns=annotation(signature.return_annotation),
                lineno=attribute.lineno,
                endlineno=attribute.endlineno,
            )
            function.docstring = griffe.Docstring(inspect.getdoc(method) or "", parent=function)
            cls.set_member(attribute.name, function)
