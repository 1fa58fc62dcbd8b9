"""The stability of a scene in sentences, with remedies, from the map `stability` of `hapticd check --json`."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from hapticd.base import wording

MAX_EXPLAINED_SETS: Final = 5
"""Maximum number of contact sets that are explained, one line each."""
_MAX_NAMED_OBJECTS: Final = 4
"""Maximum number of objects of a set that are named."""


def stability_words(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return a label and a sentence on the scene's stability, then a pair for each of the worst contact sets."""
    if found["unknown"] is not None:
        return [("stability", f"not known: {found['unknown']}")]
    return [
        ("stability", _scene_text(found)),
        *((margin["verdict"], _set_text(margin, found)) for margin in _explained_sets(found)),
    ]


def _explained_sets(found: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    worst: Sequence[Mapping[str, Any]] = found["worst"]
    return [margin for margin in worst if not margin["safe"]][:MAX_EXPLAINED_SETS]


def _scene_text(found: Mapping[str, Any]) -> str:
    sets, unproved = found["sets"], found["unsafe"]
    if not sets:
        return "the scene has nothing that can be touched"
    if not unproved:
        return "all that can be touched is stable in any hand"
    harmful = sum(margin["verdict"] == "unsafe" for margin in found["worst"])
    if harmful:
        more = "at least " if unproved > len(found["worst"]) else ""
        of = "what can be touched" if sets == 1 else f"{more}{harmful} of {sets} sets of objects"
        advice = "lower the stiffness, or raise servo.rate_hz unless the link is slower, see docs/stability.md"
        return f"{of} may oscillate: {advice}"
    of = "" if sets == 1 else f" for {unproved} of {sets} sets of objects"
    return f"stable with the configured hand; not proved for every hand{of}. Nothing needs to be done"


def _set_text(margin: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    names, limit, damping = margin["objects"], margin["limit_n_per_m"], margin["damping_n_s_per_m"]
    more = f" and {len(names) - _MAX_NAMED_OBJECTS} more" if len(names) > _MAX_NAMED_OBJECTS else ""
    which = ", ".join(names[:_MAX_NAMED_OBJECTS]) + more
    remedy = margin.get("remedy", "")
    if remedy:
        text = f"{which}: {margin['stiffness_n_per_m']:.4g} N/m is not proved to be stable in any hand"
    elif limit > 0.0:
        stiffness = margin["stiffness_n_per_m"]
        text = (
            f"{which}: {stiffness:.4g} N/m is not below {wording.below(limit, stiffness)} N/m, "
            "the limit up to which a wall is proved to be stable in any hand"
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
        return f"{text}. With {remedy} this could be proved"
    if margin["limited_by"] == "eigenvalues":
        return f"{text}, and it oscillates with the configured hand. Needed: {remedy}"
    return f"{text}; it may oscillate, at least when nobody holds the handle. Needed: {remedy}"
