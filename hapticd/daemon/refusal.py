"""Why a request is refused, as the error object of its answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from hapticd.base.errors import Problem
from hapticd.protocol.messages import Code


class MethodError(Exception):
    """The error object of an answer."""

    def __init__(self, code: Code, message: str, data: object = None) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.data = data

    @classmethod
    def faulty(cls, problems: Sequence[Problem]) -> Self:
        """Params are not valid."""
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        data = [{"where": problem.where, "problem": problem.problem} for problem in problems]
        return cls(Code.INVALID_PARAMS, f"{problems[0]}{more}", data)
