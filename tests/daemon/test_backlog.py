"""Messages that wait for subscribers who are behind: in their order, once for all, within bounds."""

from __future__ import annotations

from hapticd.daemon import backlog
from hapticd.daemon.backlog import Backlog, Reader

TOPICS = (b"a", b"b")


def all_of(made: Backlog, reader: Reader) -> list[bytes]:
    return list(iter(lambda: made.take(reader), None))


def test_topics_come_in_the_order_in_which_they_were_sent() -> None:
    made, reader, other = Backlog(TOPICS), Reader(), Reader()
    made.put(b"a", b"before")
    assert len(made) == 0, "nobody waits"
    made.join(reader, b"a")
    made.put(b"a", b"1")
    made.put(b"b", b"nobody waits for it")
    made.join(reader, b"b")
    made.join(other, b"b")
    for number in range(2, 6):
        made.put(TOPICS[number % 2], b"%d" % number)
    assert all_of(made, reader) == [b"1", b"2", b"3", b"4", b"5"]
    assert all_of(made, other) == [b"3", b"5"], "b alone"
    for each in (reader, other):
        for topic in TOPICS:
            made.leave(each, topic)
    assert len(made) == 0 and not made.waits(b"a") and not made.waits(b"b")


def test_the_newest_are_kept_and_the_others_counted() -> None:
    made, reader = Backlog(TOPICS), Reader()
    made.join(reader, b"a")
    for number in range(backlog.MESSAGES + 7):
        made.put(b"a", b"%d" % number)
    assert made.lost(reader) == 7 and made.lost(reader) == 0
    assert made.take(reader) == b"7"
    made.put(b"a", b"x")
    assert made.lost(reader) == 0, "the oldest was taken"
    made.put(b"a", b"x")
    assert made.lost(reader) == 1


def test_large_messages_are_few() -> None:
    made, reader = Backlog(TOPICS), Reader()
    made.join(reader, b"a")
    large = bytes(backlog.BYTES // 3)
    for _ in range(10):
        made.put(b"a", large)
    assert len(made) == 3
    made.put(b"a", bytes(2 * backlog.BYTES))
    assert len(made) == 1, "the newest is there, however large"
