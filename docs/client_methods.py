"""An extension of Griffe for docs/reference/python.md: the methods of the blocking client. mkdocs.yml names this file.

Griffe reads the code without running it. The blocking client's methods are made of the coroutines in
hapticd/client/methods.py when their module is imported, so Griffe alone finds neither signatures nor docstrings.
"""

from __future__ import annotations

import importlib
import inspect
from typing import Any

import griffe

METHOD_MAKERS = ("_method(", "_block(", "_subscription(", "_like(")
PARAMETER_KINDS = {
    inspect.Parameter.POSITIONAL_ONLY: griffe.ParameterKind.positional_only,
    inspect.Parameter.POSITIONAL_OR_KEYWORD: griffe.ParameterKind.positional_or_keyword,
    inspect.Parameter.VAR_POSITIONAL: griffe.ParameterKind.var_positional,
    inspect.Parameter.KEYWORD_ONLY: griffe.ParameterKind.keyword_only,
    inspect.Parameter.VAR_KEYWORD: griffe.ParameterKind.var_keyword,
}


def annotation(given: object) -> str | None:
    """Return an annotation as text, as the code has it; None for a missing one."""
    if given is inspect.Signature.empty:
        return None
    return given if isinstance(given, str) else inspect.formatannotation(given)


def parameter(given: inspect.Parameter) -> griffe.Parameter:
    """Return a parameter in the form of Griffe."""
    default = None if given.default is inspect.Parameter.empty else repr(given.default)
    return griffe.Parameter(
        given.name, annotation=annotation(given.annotation), kind=PARAMETER_KINDS[given.kind], default=default
    )


class ClientMethods(griffe.Extension):
    """Replaces attributes of a client's class by the methods that they become when the module is imported."""

    def on_class(self, *, cls: griffe.Class, **kwargs: Any) -> None:
        if not cls.path.startswith("hapticd.client.blocking."):
            return
        made = [
            each
            for each in cls.members.values()
            if isinstance(each, griffe.Attribute) and str(each.value).startswith(METHOD_MAKERS)
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
