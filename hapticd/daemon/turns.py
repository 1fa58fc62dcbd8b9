"""Whose turn it is: one after the other among users, among the processes of each, and among what each of these has.

So what one user or one process wants, however much and over however many connections, costs another one turn at a time.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import Generic, Protocol, TypeVar


class Owned(Protocol):
    """What belongs to a process of a user."""

    @property
    def uid(self) -> int: ...
    @property
    def pid(self) -> int: ...


T = TypeVar("T", bound=Owned)


class Turns(Generic[T]):
    """Those who wait for their turn; whoever wants another one is added again."""

    def __init__(self) -> None:
        self._users: OrderedDict[int, OrderedDict[int, deque[T]]] = OrderedDict()

    def __bool__(self) -> bool:
        return bool(self._users)

    def add(self, waiting: T) -> None:
        """Behind the others of its process."""
        processes = self._users.get(waiting.uid)
        if processes is None:
            processes = self._users[waiting.uid] = OrderedDict()
        queue = processes.get(waiting.pid)
        if queue is None:
            queue = processes[waiting.pid] = deque()
        queue.append(waiting)

    def next(self) -> T:
        """The one whose turn it is, which does not wait any more. Raises KeyError: nobody waits."""
        uid, processes = self._users.popitem(last=False)
        pid, queue = processes.popitem(last=False)
        found = queue.popleft()
        if queue:
            processes[pid] = queue
        if processes:
            self._users[uid] = processes
        return found
