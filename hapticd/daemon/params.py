"""What the methods of the protocol take. `docs/protocol.md` is the reference."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hapticd.base.model import Model, Name, Position
from hapticd.config.modes import ModeKeys
from hapticd.daemon.lease import MAX_DURATION_S


class NoParams(Model):
    pass


class GetStatusParams(Model):
    detail: bool = False


class ChangeParams(Model):
    expect_revision: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = None
    wait: bool = False


class SetSceneParams(ChangeParams):
    scene: object


class UpdateSceneParams(ChangeParams):
    objects: dict[str, object]


class UpdateMaterialsParams(ChangeParams):
    materials: dict[str, object]


class SetMaterialsParams(ChangeParams):
    materials: dict[str, object]


class ApplyParams(ChangeParams):
    materials: dict[str, object] | None = None
    scene: object = None


class ReloadParams(ChangeParams):
    pass


class PlayParams(Model):
    direction: Position
    amplitude_m_per_s2: float = Field(ge=0, le=1e5)
    mode: ModeKeys | None = None
    material: Name | None = None


class ResetParams(Model):
    objects: Annotated[list[str], Field(max_length=1000)] | None = None


class SetForcesParams(Model):
    enabled: bool


class LeaseParams(Model):
    duration_s: float = Field(ge=0, le=MAX_DURATION_S)
    token: Annotated[str, Field(max_length=256)] | None = None
