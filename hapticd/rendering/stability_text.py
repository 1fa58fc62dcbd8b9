"""What a person reads of a scene's stability: what it means and what to do. From the map of `check --json`."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

MOST_EXPLAINED: Final = 5
"""Sets of objects that are explained one by one."""
_SHOWN_OBJECTS: Final = 4


def stability_words(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """A line on the whole scene, then one for each of the worst sets: what it is about, and the words."""
    if found["unknown"] is not None:
        return [("stability", f"not known: {found['unknown']}")]
    return [("stability", _whole(found)), *((margin["verdict"], _one(margin, found)) for margin in _worst(found))]


def _worst(found: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    worst: Sequence[Mapping[str, Any]] = found["worst"]
    return [margin for margin in worst if not margin["safe"]][:MOST_EXPLAINED]


def _whole(found: Mapping[str, Any]) -> str:
    sets, unproved = found["sets"], found["unsafe"]
    if not sets:
        return "the scene has nothing that can be touched"
    if not unproved:
        return "all that can be touched is stable in any hand"
    harmful = sum(margin["verdict"] == "unsafe" for margin in found["worst"])
    if harmful:
        more = "at least " if unproved > len(found["worst"]) else ""
        of = "what can be touched" if sets == 1 else f"{more}{harmful} of {sets} sets of objects"
        return f"{of} may oscillate: lower the stiffness or raise servo.rate_hz, see docs/stability.md"
    of = "" if sets == 1 else f" for {unproved} of {sets} sets of objects"
    return (
        f"stable in the hand that is configured; that it is in every other hand too is not proved{of}. "
        "Nothing needs to be done"
    )


def _one(margin: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    names, limit, damping = margin["objects"], margin["limit_n_per_m"], margin["damping_n_s_per_m"]
    more = f" and {len(names) - _SHOWN_OBJECTS} more" if len(names) > _SHOWN_OBJECTS else ""
    which = ", ".join(names[:_SHOWN_OBJECTS]) + more
    remedy = margin.get("remedy", "")
    if remedy:
        text = f"{which}: {margin['stiffness_n_per_m']:.4g} N/m are not proved to be stable in any hand"
    elif limit > 0.0:
        stiffness = margin["stiffness_n_per_m"]
        text = (
            f"{which}: {stiffness:.4g} N/m are not below the {limit:.4g} N/m "
            "up to which a wall is proved to be stable in any hand"
        )
        by = "a finer encoder" if margin["limited_by"] == "quantisation" else "a higher servo.rate_hz"
        remedy = f"a lower stiffness or {by}"
    elif damping > 0.0:
        own = f"{found['assumed']['handle_damping_n_s_per_m']:.3g} N s/m"
        text = (
            f"{which}: with a damping of {damping:.3g} N s/m no stiffness is proved to be stable in any hand, "
            f"as the handle itself damps by {own}"
        )
        remedy = "less damping"
    else:
        text = f"{which}: on this handle no stiffness is proved to be stable in any hand"
        remedy = "a handle with more damping and friction"
    if margin["verdict"] == "unproved":
        return f"{text}. {remedy[0].upper()}{remedy[1:]} would have a proof"
    if margin["limited_by"] == "eigenvalues":
        return f"{text}, and in the hand that is configured it oscillates. Needed: {remedy}"
    return f"{text}; it may oscillate, with the handle let go at the latest. Needed: {remedy}"
