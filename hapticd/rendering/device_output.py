"""Properties of the configured device for rendering: the way of forces to the device, and the closed loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from hapticd.config.actuator import Actuator
from hapticd.config.configuration import Compensation, Config, Device
from hapticd.config.dynamics import Dynamics
from hapticd.rendering.stability import Loop, Timing, timing

UNKNOWN_HANDLE: Final = "device.handle is not given; it needs mass_kg, damping_n_s_per_m and friction_n"
"""Reason in a report why the stability of a real joystick is unknown."""


@dataclass(frozen=True, slots=True)
class Output:
    """Properties of device and rate for which a scene is compiled."""

    rate_hz: float
    effective_mass_kg: float
    max_force_n: float
    max_speed_m_per_s: float
    undisplayable: Literal["mute", "lower"]
    link_rate_hz: float | None = None
    """Forces per second that the link to the device carries; None: one at each tick."""
    compensation: Compensation = "off"
    dynamics: Dynamics | None = None
    """Mass, spring and damping of handle and hand, for which strikes are compensated; None: unknown."""
    rearm_m: float = 0.0
    """Distance to which the probe must withdraw from a surface before the surface can be tapped again."""
    age_s: float = 0.0
    """Time from the measurement of a position until its force acts; 0 if unknown."""
    actuator: Actuator | None = None
    """Lag of the actuator; None: unknown."""

    @property
    def carried_hz(self) -> float:
        """Forces per second that reach the device: the rate of the servo, or of the link if that is lower."""
        return self.rate_hz if self.link_rate_hz is None else min(self.rate_hz, self.link_rate_hz)

    @property
    def slow_link(self) -> bool:
        """Whether the link carries fewer forces per second than the servo computes."""
        return self.carried_hz < self.rate_hz


def output_of(config: Config, rate_hz: float, link_rate_hz: float | None = None) -> Output:
    """Return the Output (properties for rendering) of the configured device at a servo rate.

    `link_rate_hz` is the number of forces per second that the device accepts; the simulated joystick has its own link.
    """
    device = config.device
    if device.kind == "sim" and device.sim.link is not None:
        link_rate_hz = device.sim.link.rate_hz
    return Output(
        rate_hz=rate_hz,
        effective_mass_kg=device.effective_mass_kg,
        max_force_n=device.max_force_n,
        max_speed_m_per_s=device.max_speed_m_per_s,
        undisplayable=device.undisplayable,
        link_rate_hz=link_rate_hz,
        compensation=device.compensation,
        dynamics=device.dynamics,
        rearm_m=device.rearm_m,
        age_s=device.sim.age_s if device.kind == "sim" else 0.0,
        actuator=device.lag,
    )


def loop_of(
    config: Config,
    rate_hz: float,
    *,
    resolution_m: float = 0.0,
    force_step_n: float = 0.0,
    link_rate_hz: float | None = None,
) -> Loop | None:
    """Return the closed loop of the configured device at a servo rate; None if `device.handle` is needed and missing.

    Resolution, force step and link rate are those of a real device (0 and None: unknown); the simulated joystick has
    its own. A real link is assumed to delay positions by a frame and forces by another frame.
    """
    device, sim = config.device, config.device.sim
    dynamics = device.dynamics
    if dynamics is None:
        return None
    if device.kind == "sim":
        interval_s, age_s = sim.reports_s
        frame_s, frames = (0.0, 1) if sim.link is None else (1.0 / sim.link.rate_hz, sim.link.delay_frames)
        return Loop(
            _lagging(device, timing(rate_hz, interval_s, age_s, frame_s, frames)),
            dynamics,
            sim.encoder_step_m,
            sim.force_step_n,
            min(device.max_force_n, sim.max_force_n),
            sim.workspace_m,
        )
    frame_s = 1.0 / min(rate_hz, rate_hz if link_rate_hz is None else link_rate_hz)
    return Loop(
        _lagging(device, timing(rate_hz, frame_s, frame_s, frame_s, 1)),
        dynamics,
        resolution_m,
        force_step_n,
        device.max_force_n,
        device.hid.travel_m,
    )


def _lagging(device: Device, timing: Timing) -> Timing:
    """Return a timing to which the lag of the device's actuator is added, if known."""
    known = device.lag
    return timing if known is None else timing.with_actuator(*known.moments())
