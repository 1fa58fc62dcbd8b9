"""The params of the protocol's methods. `docs/protocol.md` is the reference, and has the same descriptions.

The methods validate scenes and materials themselves; `DescribedAs` puts their schema into the JSON Schema.
"""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import ConfigDict, Field

from hapticd.base.model import DescribedAs, Model, Name, Position
from hapticd.config.materials import MAX_MATERIALS, Material
from hapticd.config.modes import ModeKeys, given, one_of
from hapticd.config.scene import ForceVector, Scene
from hapticd.daemon.lease import MAX_LEASE_DURATION_S
from hapticd.protocol.streams import MAX_SEQ

_MaterialsField: Final = DescribedAs(Annotated[dict[Name, Material], Field(max_length=MAX_MATERIALS)])


class NoParams(Model):
    """Params of a method that takes none."""


class GetStatusParams(Model):
    """Params of `get_status`."""

    detail: bool = Field(default=False, description="whether the result has `histograms`, which are half of its size")


class ChangeParams(Model):
    """Params of every method that changes scene or materials."""

    expect_revision: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = Field(
        default=None, description="refuse (-32001) if the scene has a different revision"
    )
    wait: bool = Field(default=False, description="answer when the servo has taken the change")


class SceneChangeParams(ChangeParams):
    """Params of every method that may put objects under the hand."""

    force: bool = Field(
        default=False,
        description="make the change even if a new or moved object holds the handle deep inside, while forces are on "
        "(else it is refused, -32011)",
    )


class SetSceneParams(SceneChangeParams):
    """Params of `set_scene`."""

    scene: Annotated[object, DescribedAs(Scene)] = Field(
        description="a scene, as in materials.md, without the key `scene` around it"
    )


class UpdateSceneParams(SceneChangeParams):
    """Params of `update_scene`."""

    objects: dict[str, object] = Field(
        description="by id: a JSON Merge Patch (RFC 7396) of the object, or nil, which removes the object"
    )


class UpdateMaterialsParams(ChangeParams):
    """Params of `update_materials`."""

    materials: dict[str, object] = Field(
        description="by name: a JSON Merge Patch (RFC 7396) of the material, or nil, which removes the material"
    )


class SetMaterialsParams(ChangeParams):
    """Params of `set_materials`."""

    materials: Annotated[dict[str, object], _MaterialsField] = Field(
        description="by name: a material, as in materials.md"
    )


class ApplyParams(SceneChangeParams):
    """Params of `apply`: materials, a scene or both."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [given("materials"), {"required": ["scene"]}]})

    materials: Annotated[dict[str, object], _MaterialsField] | None = Field(
        default=None, description="by name: a material, as in materials.md"
    )
    scene: Annotated[object, DescribedAs(Scene)] = Field(
        default=None, description="a scene, as in materials.md, without the key `scene` around it"
    )


class ReloadParams(SceneChangeParams):
    """Params of `reload`."""


class PlayParams(Model):
    """Params of `play`: a mode or the name of a material."""

    model_config = ConfigDict(json_schema_extra=one_of("mode", "material"))

    direction: Position = Field(
        description="direction of the first half wave's force; its length, at least 1e-9, does not matter"
    )
    amplitude_m_per_s2: float = Field(
        ge=0, le=1e5, description="coefficient A of the mode; with `material`, the quantity that its `attack` defines"
    )
    mode: ModeKeys | None = Field(
        default=None,
        description="`frequency_hz` or `angular_frequency_rad_per_s`, and `decay_time_s` or `decay_rate_per_s`",
    )
    material: Name | None = Field(
        default=None,
        description="strikes the material's tap or, if it has none, its rupture. A material whose tap is a waveform is "
        "refused (-32602)",
    )


class ResetParams(Model):
    """Params of `reset`."""

    objects: Annotated[list[str], Field(max_length=1000)] | None = Field(
        default=None, description="ids of objects; default: all objects"
    )


class SetForcesParams(Model):
    """Params of `set_forces`."""

    enabled: bool = Field(description="whether forces are on")


class LeaseParams(Model):
    """Params of `lease`."""

    duration_s: float = Field(ge=0, le=MAX_LEASE_DURATION_S, description="how long the lease lasts from now; 0 ends it")
    token: Annotated[str, Field(max_length=256)] | None = Field(
        default=None, description="token of the lease to renew or end; without it a new lease is taken"
    )


class StreamParams(Model):
    """Params of every message of a stream."""

    seq: Annotated[int, Field(ge=0, le=MAX_SEQ)] = Field(
        description="sequence number, greater than that of the previous message"
    )


class StreamTargetParams(StreamParams):
    """Params of `stream_target`."""

    position_m: Position = Field(description="target position of the hand on the simulated joystick")


class StreamForceParams(StreamParams):
    """Params of `stream_force`."""

    force_n: ForceVector = Field(description="a force that is added to the rendered one")
