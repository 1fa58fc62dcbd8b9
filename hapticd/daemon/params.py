"""What the methods of the protocol take. `docs/protocol.md` is the reference, and has the same descriptions.

What scene and materials hold is validated by the methods; `DescribedAs` says in the JSON Schema what it is.
"""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import ConfigDict, Field

from hapticd.base.model import DescribedAs, Model, Name, Position
from hapticd.config.materials import MAX_MATERIALS, Material
from hapticd.config.modes import ModeKeys, given, one_of
from hapticd.config.scene import ForceVector, Scene
from hapticd.daemon.lease import MAX_DURATION_S
from hapticd.protocol.streams import MAX_SEQ

_MATERIALS: Final = DescribedAs(Annotated[dict[Name, Material], Field(max_length=MAX_MATERIALS)])


class NoParams(Model):
    """None."""


class GetStatusParams(Model):
    detail: bool = Field(default=False, description="whether the result has `histograms`, which are half of its size")


class ChangeParams(Model):
    expect_revision: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = Field(
        default=None, description="refuse (-32001) if the scene's revision is another"
    )
    wait: bool = Field(default=False, description="answer when the servo has taken it")


class SetSceneParams(ChangeParams):
    scene: Annotated[object, DescribedAs(Scene)] = Field(
        description="a scene, as in materials.md, without the key `scene` around it"
    )


class UpdateSceneParams(ChangeParams):
    objects: dict[str, object] = Field(
        description="by id: a JSON Merge Patch (RFC 7396) of the object, or nil, which removes the object"
    )


class UpdateMaterialsParams(ChangeParams):
    materials: dict[str, object] = Field(description="by name: a JSON Merge Patch over the material, or nil")


class SetMaterialsParams(ChangeParams):
    materials: Annotated[dict[str, object], _MATERIALS] = Field(description="by name: a material, as in materials.md")


class ApplyParams(ChangeParams):
    model_config = ConfigDict(json_schema_extra={"anyOf": [given("materials"), {"required": ["scene"]}]})

    materials: Annotated[dict[str, object], _MATERIALS] | None = Field(
        default=None, description="by name: a material, as in materials.md"
    )
    scene: Annotated[object, DescribedAs(Scene)] = Field(
        default=None, description="a scene, as in materials.md, without the key `scene` around it"
    )


class ReloadParams(ChangeParams):
    pass


class PlayParams(Model):
    model_config = ConfigDict(json_schema_extra=one_of("mode", "material"))

    direction: Position = Field(
        description="where the first half wave pushes; its length, at least 1e-9, does not matter"
    )
    amplitude_m_per_s2: float = Field(
        ge=0, le=1e5, description="coefficient A of the mode; with `material`, what the material's `attack` defines"
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
    objects: Annotated[list[str], Field(max_length=1000)] | None = Field(default=None, description="default: all")


class SetForcesParams(Model):
    enabled: bool = Field(description="on or off")


class LeaseParams(Model):
    duration_s: float = Field(ge=0, le=MAX_DURATION_S, description="how long the lease lasts from now; 0 ends it")
    token: Annotated[str, Field(max_length=256)] | None = Field(
        default=None, description="of the lease to renew or end; without it a new one is taken"
    )


class StreamParams(Model):
    seq: Annotated[int, Field(ge=0, le=MAX_SEQ)] = Field(description="greater than that of the previous message")


class StreamTargetParams(StreamParams):
    position_m: Position = Field(description="target position of the hand on the simulated joystick")


class StreamForceParams(StreamParams):
    force_n: ForceVector = Field(description="a force that is added to the rendered one")
