"""The exception that carries the error object of an answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from hapticd.base.errors import Problem
from hapticd.protocol.messages import Code


class MethodError(Exception):
    """A request is refused; the exception has the members of the answer's error object."""

    def __init__(self, code: Code, message: str, data: object = None) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.data = data

    @classmethod
    def faulty(cls, problems: Sequence[Problem], code: Code = Code.INVALID_PARAMS, count: int = 0) -> Self:
        """Return the error that reports these problems; `count` is their number with those that are left out."""
        count = max(count, len(problems))
        more = f" (and {count - 1} more)" if count > 1 else ""
        data = [{"where": problem.where, "problem": problem.problem} for problem in problems]
        if count > len(problems):
            data.append({"where": "", "problem": f"and {count - len(problems)} more"})
        return cls(code, f"{problems[0]}{more}", data)

    def prefixed(self, where: str) -> Self:
        """Return the error with `where` in front of its message and of the places of its problems."""
        data = self.data
        if isinstance(data, list):
            data = [each | {"where": f"{where}{each['where']}"} if each["where"] else each for each in data]
        return type(self)(self.code, f"{where}{self.message}", data)
