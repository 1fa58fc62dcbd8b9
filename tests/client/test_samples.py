"""Batches of samples, and counts of missing samples."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.client.samples import SampleBatch, SampleStream
from hapticd.protocol.calls import TelemetryLoss

DESCRIPTION = [list(field) for field in np.lib.format.dtype_to_descr(SAMPLE_DTYPE)]


def message(ticks: range | list[int], dropped: int = 0) -> dict[str, object]:
    samples = np.zeros(len(ticks), SAMPLE_DTYPE)
    samples["tick"] = ticks
    samples["position_m"] = [(tick, -tick) for tick in ticks]
    return {"first_tick": ticks[0], "dropped": dropped, "dtype": DESCRIPTION, "data": samples.tobytes()}


def fed(*messages: dict[str, object]) -> tuple[SampleStream, list[SampleBatch]]:
    stream = SampleStream(warn=False)
    return stream, [stream.convert("samples", each) for each in messages]


def test_a_batch_is_a_structured_array() -> None:
    _, (batch,) = fed(message(range(5, 9), 3))
    assert batch.dtype == SAMPLE_DTYPE
    assert (batch.first_tick, batch.dropped, batch.lost) == (5, 3, 0)
    assert batch["tick"].tolist() == [5, 6, 7, 8]
    assert type(batch["position_m"]) is np.ndarray and batch["position_m"].shape == (4, 2)
    part = batch[1:3]
    assert isinstance(part, SampleBatch) and part.dropped == 3
    assert batch[0]["tick"] == 5
    with pytest.raises(ValueError, match="read-only"):
        batch["tick"][0] = 1
    batch.copy()["tick"][0] = 1


def test_nothing_is_lost_without_a_gap() -> None:
    stream, batches = fed(message(range(100, 300)), message(range(300, 500)), message(range(500, 501)))
    assert [batch.lost for batch in batches] == [0, 0, 0]
    assert (stream.received, stream.lost, stream.dropped) == (401, 0, 0)


def test_a_gap_is_our_loss_unless_the_ring_dropped_it() -> None:
    stream, batches = fed(message(range(0, 10)), message(range(15, 20)), message(range(27, 30), dropped=4))
    assert [batch.lost for batch in batches] == [0, 5, 3]
    assert (stream.lost, stream.dropped, stream.received) == (8, 4, 18)


def test_a_gap_inside_a_batch_counts() -> None:
    stream, batches = fed(message([0, 1, 5, 6], dropped=0), message(range(7, 9), dropped=3))
    # Ticks that the ring dropped are known only with the next batch; ticks that were counted as lost stay lost.
    assert batches[0].lost == 3
    assert stream.received == 6


def test_a_drop_that_is_counted_before_its_gap_arrives() -> None:
    stream, batches = fed(message(range(0, 10)), message(range(10, 20), dropped=5), message(range(25, 30), dropped=5))
    assert [batch.lost for batch in batches] == [0, 0, 0]
    assert (stream.lost, stream.dropped) == (0, 5)


def test_drops_before_we_listened_are_not_ours() -> None:
    stream, batches = fed(message(range(1000, 1010), dropped=77), message(range(1010, 1020), dropped=77))
    assert (stream.lost, stream.dropped) == (0, 0)
    assert batches[1].dropped == 77


def test_a_daemon_that_starts_again_loses_nothing() -> None:
    stream, batches = fed(message(range(1000, 1010), dropped=5), message(range(3, 8)), message(range(8, 12)))
    assert [batch.lost for batch in batches] == [0, 0, 0]
    assert (stream.restarts, stream.lost, stream.dropped) == (1, 0, 0)


@pytest.mark.long
@given(st.lists(st.sampled_from(["sent", "dropped", "lost"]), min_size=1, max_size=60))
def test_every_tick_is_received_dropped_or_lost(fates: list[str]) -> None:
    """The ticks before the last received one; every batch has the total of the daemon's ring."""
    fates = ["sent", *fates, "sent"]
    dropped = 0
    messages = []
    for tick, fate in enumerate(fates):
        dropped += fate == "dropped"
        if fate == "sent":
            messages.append(message([tick], dropped))
    stream, batches = fed(*messages)
    assert stream.received == fates.count("sent")
    assert stream.dropped == fates.count("dropped")
    assert stream.lost == fates.count("lost") == sum(batch.lost for batch in batches)


def test_loss_is_a_warning() -> None:
    stream = SampleStream()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stream.convert("samples", message(range(0, 10)))
    with pytest.warns(TelemetryLoss, match="2 samples before tick 12 were lost"):
        stream.convert("samples", message(range(12, 20)))


def test_fields_may_come_later() -> None:
    """A newer daemon may send more fields than this client knows."""
    description = [["tick", "<u8"], ["time_ns", "<i8"], ["new", "<f4", [3]]]
    data = np.zeros(2, [("tick", "<u8"), ("time_ns", "<i8"), ("new", "<f4", (3,))])
    _, (batch,) = fed({"first_tick": 0, "dropped": 0, "dtype": description, "data": data.tobytes()})
    assert batch["new"].shape == (2, 3)
