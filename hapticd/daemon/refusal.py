"""The exception that carries the error object of an answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from hapticd.base.errors import Problem
from hapticd.protocol.messages import Code


class MethodError(Exception):
    """A request is refused; the exception has the members of the answer's error object."""

    def __init__(self, code: Code, message: str, data: object = None) -> None:
        """Store the code, the message and the optional `data` of the error object."""
        super().__init__(message)
        self.code = code
        self.message = message
        self.data = data

    @classmethod
    def faulty(cls, problems: Sequence[Problem], code: Code = Code.INVALID_PARAMS) -> Self:
        """Return the error that reports these problems."""
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        data = [{"where": problem.where, "problem": problem.problem} for problem in problems]
        return cls(code, f"{problems[0]}{more}", data)
