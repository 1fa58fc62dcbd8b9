"""Thresholds of the fits, each with value, unit and reason; one dataclass for each kind of fit.

`make docs-tables` copies them to docs/reference/fit_limits.md. The thresholds that decide between good, fair and poor
are in verdict.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, TypeVar

from hapticd.rendering.plausibility import (
    MAX_AMPLITUDE_M_PER_S2,
    MAX_STIFFNESS_N_PER_M,
    MAX_TAP_SPEED_M_PER_S,
    MIN_AMPLITUDE_M_PER_S2,
    MIN_FREQUENCY_HZ,
    MIN_STIFFNESS_N_PER_M,
)

_T = TypeVar("_T")


def _limit(value: _T, unit: str, reason: str) -> _T:
    """Return a field of a dataclass with this default, and with unit and reason as its metadata."""
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True, slots=True)
class PreparationLimits:
    """Thresholds of the preparation for every fit: impossible samples, gaps, units, sampling rate."""

    max_force_n: float = _limit(200.0, "N", "No hand presses harder.")
    max_stroke_speed_m_per_s: float = _limit(5.0, "m/s", "No hand strokes or pierces faster.")
    max_acceleration_m_per_s2: float = _limit(1e5, "m/s^2", "The acceleration of strokes and punctures is smaller.")
    max_tap_acceleration_m_per_s2: float = _limit(1e6, "m/s^2", "A stylus that hits steel has a smaller acceleration.")
    max_invalid_fraction: float = _limit(0.01, "fraction of samples", "With more, the unit or the column is wrong.")
    max_faults: int = _limit(50, "faults a column", "More spikes and standstills are kept; more leaps are refused.")
    spike_to_noise: float = _limit(15.0, "standard deviations", "Noise does not deviate this far.")
    spike_ratio: float = _limit(8.0, "ratio", "A short spike exceeds the samples next to it by this factor.")
    max_spike_samples: int = _limit(3, "samples", "A spike of acceleration that lasts longer may be a contact.")
    max_spike_s: float = _limit(0.01, "s", "A spike of force or speed that lasts longer may be a motion of the hand.")
    min_standstill_s: float = _limit(0.05, "s", "Equal samples for a shorter time may be the sensor's resolution.")
    standstill_ratio: float = _limit(20.0, "ratio", "Standstills exceed 99 % of runs of equal samples by this factor.")
    leap_ratio: float = _limit(5.0, "ratio", "A leap is this factor larger than 99 % of the position's steps.")
    max_leap_return_s: float = _limit(0.02, "s", "A position that returns within this time had a spike, not a leap.")
    min_complete_fraction: float = _limit(0.5, "fraction", "A recording with fewer usable samples is left out.")
    min_samples_per_cycle: float = _limit(2.5, "samples", "At 2 samples per cycle a mode equals its alias.")
    min_acceleration_span_m_per_s2: float = _limit(0.02, "m/s^2", "A smaller change is not felt: the unit is wrong.")
    min_force_n: float = _limit(1e-3, "N", "If the largest force is smaller, the unit is wrong.")
    min_force_variation: float = _limit(0.2, "fraction of the mean", "Less variation does not determine a force gain.")
    max_stroke_m: float = _limit(5.0, "m", "A longer stroke has a wrong unit.")
    min_stroke_speed_m_per_s: float = _limit(1e-4, "m/s", "A slower stroke has a wrong unit or column.")
    max_speed_ratio: float = _limit(2.0, "ratio", "Speeds from column and position that differ more have a wrong unit.")
    gravity_tolerance: float = _limit(0.02, "fraction", "A rest value this near to 1 or 96 m/s^2 has a wrong unit.")


@dataclass(frozen=True, slots=True)
class TapLimits:
    """Thresholds of the fit of taps that ring."""

    min_acceleration_m_per_s2: float = _limit(1e-3, "m/s^2", "If the largest value is smaller, the unit is wrong.")
    min_peak_to_noise: float = _limit(8.0, "ratio", "The peak of white noise alone stays below this ratio.")
    min_loud_level: float = _limit(0.05, "fraction of the peak", "Samples below this level do not belong to a tap.")
    min_quiet_s: float = _limit(0.02, "s", "A time of this length without a loud sample separates two events.")
    max_pause: float = _limit(0.2, "fraction of the loud time", "A longer quiet time ends an event that rings long.")
    min_onset_distance_s: float = _limit(0.05, "s", "A hand does not tap again sooner.")
    min_onset_rise: float = _limit(1.4, "ratio", "A larger abrupt rise within an event is the onset of another tap.")
    max_remainder: float = _limit(0.25, "fraction of the tap", "If the tap before rings more, a tap is left out.")
    max_bounce_s: float = _limit(0.15, "s", "A weaker event within this time after a tap is its bounce.")
    max_bounce_size: float = _limit(0.8, "fraction of the tap before", "A larger event is a tap.")
    long_event_s: float = _limit(0.1, "s", "A longer event does not count for gravity and drift.")
    short_recording_s: float = _limit(0.5, "s", "Shorter recordings have their level and noise from before the tap.")
    max_rest_change: float = _limit(0.1, "fraction of the largest change", "The initial rest ends at a larger change.")
    approach_s: float = _limit(0.01, "s", "The speed is the slope of the position over this time before the onset.")
    min_approach_samples: int = _limit(4, "samples", "Fewer positions do not determine a speed.")
    max_approach_residual: float = _limit(0.5, "fraction of the variance", "A steady approach has a smaller residual.")
    min_rest_samples: int = _limit(2, "samples", "After less rest the offset of a tap is unknown.")
    certain_rest_samples: int = _limit(8, "samples", "After this rest the onset of a tap is not checked.")
    max_onset_error_samples: float = _limit(1.0, "samples", "After a short rest the standard error must be smaller.")
    min_samples_per_cycle: float = _limit(2.05, "samples", "At 2 samples amplitude and onset cannot be separated.")
    max_relative_error: float = _limit(0.5, "fraction", "A tap with a larger error of any parameter is left out.")
    min_shapeless_peak_to_noise: float = _limit(16.0, "ratio", "A louder tap that fits badly has another shape.")
    min_decay_samples: float = _limit(2.0, "samples", "A decay to 1/e in fewer samples is a glitch of the sensor.")
    fit_decay_times: float = _limit(7.0, "decay times", "A tap is fitted up to this time; it has then fallen to 0.001.")
    min_explained: float = _limit(0.5, "fraction of the variance", "If the modes explain less, the tap is left out.")
    well_explained: float = _limit(0.95, "fraction of the variance", "If one mode explains less, two modes are tried.")
    max_frequency_difference: float = _limit(0.1, "difference of logarithms", "Modes that differ less are the same.")
    min_same_pairs: float = _limit(0.7, "fraction of the pairs", "If fewer mode pairs agree, there is no second mode.")
    min_second_gain: float = _limit(0.01, "fraction of the variance", "A second mode that adds less is not offered.")
    max_second_ratio: float = _limit(10.0, "ratio", "A second mode with a larger amplitude is an artefact of the fit.")
    min_second_periods: float = _limit(0.3, "periods", "A second mode that decays to 1/e in fewer periods is a pulse.")
    max_residual_to_noise: float = _limit(1.3, "ratio", "A larger residual is more than the noise before the onset.")
    min_pattern_rms: float = _limit(0.02, "fraction of the ringing", "A weaker pattern in residuals is not reported.")
    max_opposite_fraction: float = _limit(0.25, "fraction of taps", "A fit with more taps of opposite sign is refused.")
    min_frequency_hz: float = _limit(MIN_FREQUENCY_HZ, "Hz", "A slower vibration is a motion of the hand.")
    max_decay_time: float = _limit(0.5, "fraction of the fitted time", "A slower decay is not that of a tap.")
    min_frequency_change: float = _limit(0.02, "fraction", "A smaller change with speed needs no table of modes.")
    min_decay_change: float = _limit(0.1, "fraction", "A smaller change with speed needs no table of modes.")
    max_table_error: float = _limit(2.0, "fraction", "A table of modes with a more uncertain value is not used.")


@dataclass(frozen=True, slots=True)
class SpeedLawLimits:
    """Thresholds of the law of amplitude versus approach speed, for taps that ring and for pulses."""

    min_taps: int = _limit(3, "taps", "Fewer taps give no useful interval.")
    min_speed_m_per_s: float = _limit(1e-3, "m/s", "A slower tap has a wrong unit.")
    max_speed_m_per_s: float = _limit(MAX_TAP_SPEED_M_PER_S, "m/s", "A faster tap has a wrong unit.")
    min_speed_ratio: float = _limit(1.2, "ratio of fastest to slowest", "Speeds that differ less determine no slope.")
    min_slope_to_angular_frequency: float = _limit(0.003, "ratio", "Taps of Okamura et al. (1998) have 0.07 to 0.87.")
    max_slope_to_angular_frequency: float = _limit(10.0, "ratio", "A larger ratio has a wrong unit.")
    significance: float = _limit(0.01, "probability", "An effect with a larger p-value is not significant.")
    min_bend: float = _limit(0.05, "RMS fraction of the line", "A law that differs less from the line is not used.")
    min_aicc_gain: float = _limit(2.0, "AICc", "A law other than the line needs an AICc lower by this (Burnham 2002).")
    max_table_speeds: int = _limit(8, "speeds", "A material needs no finer table.")
    min_table_step: float = _limit(1.02, "ratio of neighbours", "Speeds of a table that differ less are merged.")
    max_scatter: float = _limit(0.15, "RMS fraction of the law", "The r^2 of a curve with less scatter is not judged.")
    high_rank_correlation: float = _limit(0.8, "rank correlation", "Above this the amplitudes rise from tap to tap.")
    min_outlier_distance: float = _limit(0.25, "fraction of the line", "A single tap farther off the line is reported.")


@dataclass(frozen=True, slots=True)
class WaveformLimits:
    """Thresholds of the fit of taps that are pulses, and of the choice between mode and waveform."""

    min_mode_periods: float = _limit(0.3, "periods", "A mode that decays to 1/e in fewer periods is a pulse.")
    min_mode_explained: float = _limit(0.95, "fraction of the variance", "A mode that explains more is preferred.")
    max_residual_ratio: float = _limit(0.5, "ratio of residual variances", "A waveform with a smaller ratio is chosen.")
    min_pulses: int = _limit(3, "pulses", "Fewer pulses give no useful interval.")
    rise_end_level: float = _limit(0.6, "fraction of the peak", "The rise of a pulse ends at this level.")
    alignment_level: float = _limit(0.25, "fraction of the peak", "Pulses are aligned where they reach this level.")
    max_faint_energy: float = _limit(5e-4, "fraction of the energy", "Ends of a pulse with less energy are cut off.")
    min_samples: int = _limit(8, "samples", "A curve with fewer samples has no shape.")
    max_coarse_loss: float = _limit(1e-4, "fraction of the variance", "Halving the rate may lose at most this.")
    max_end_level: float = _limit(0.05, "fraction of the peak", "A waveform that ends above this level is faded out.")
    fade_out_fraction: float = _limit(0.2, "fraction of the length", "This last part of a pulse is faded out.")
    min_explained: float = _limit(0.5, "fraction of the variance", "If the others explain less, a pulse is left out.")
    error_to_change: float = _limit(4 / 3, "ratio", "Error over change at twice the rate (second order).")
    min_ringing_turns: int = _limit(2, "changes of sign", "A pulse that has not ended, and has as many, rings.")
    max_groups: int = _limit(16, "groups", "With more pulses the jackknife leaves out groups of pulses.")


@dataclass(frozen=True, slots=True)
class RingingLimits:
    """Thresholds of the fit of decaying sinusoids, which taps and punctures share."""

    min_samples: int = _limit(16, "samples", "Fewer samples do not determine a mode.")
    judged_decay_times: float = _limit(5.0, "decay times", "The explained variance is counted up to this time.")


@dataclass(frozen=True, slots=True)
class SpectralLineLimits:
    """Thresholds of the search for hum and other tones, in all fits."""

    min_frequency_hz: float = _limit(20.0, "Hz", "A slower vibration is a motion of the hand.")
    max_chance: float = _limit(1e-3, "probability", "Noise alone has a line in one of a thousand recordings.")
    min_power_fraction: float = _limit(0.005, "fraction of the power", "A weaker line does not change the results.")
    max_same_hz: float = _limit(0.5, "Hz", "Nearer lines of two recordings are the same line.")
    noise_band_hz: float = _limit(8.0, "Hz", "The noise near a line is measured over this band on each side.")
    min_recording_s: float = _limit(0.5, "s", "A shorter recording does not separate a line from a ringing.")
    max_lines: int = _limit(5, "lines", "A report names only the loudest lines.")


@dataclass(frozen=True, slots=True)
class GrooveLimits:
    """Thresholds of the fit of grooves."""

    min_section_s: float = _limit(0.1, "s", "A shorter section between gaps and clipped samples is left out.")
    min_strikes: int = _limit(8, "strikes", "Fewer strikes show no row of grooves.")
    min_strike_size: float = _limit(0.3, "fraction of strong strikes", "Weaker steps of the ringing are not strikes.")
    window_cycles: float = _limit(1.25, "cycles", "Windows of this length before and after a sample show a strike.")
    strikes_in_group: int = _limit(8, "strikes", "Frequency and decay are fitted to groups of this size.")
    max_even_scatter: float = _limit(0.05, "RMS fraction of the spacing", "The search for a damping ends below this.")
    max_first_unevenness: float = _limit(0.22, "RMS fraction of the spacing", "Strikes at random positions have 0.29.")
    max_unevenness: float = _limit(0.12, "RMS fraction of the spacing", "A less even row is not a row of grooves.")
    max_offset: float = _limit(0.25, "fraction of the spacing", "A strike farther from its groove is left out.")
    min_regular_fraction: float = _limit(0.7, "fraction of the strikes", "If fewer lie in a row, there are no grooves.")
    min_explained: float = _limit(0.5, "fraction of the variance", "A mode that explains less is not one of grooves.")
    min_amplitude_m_per_s2: float = _limit(0.1, "m/s^2", "If the median strike is weaker, the unit is wrong.")
    max_amplitude_m_per_s2: float = _limit(5000.0, "m/s^2", "If the median strike is stronger, the unit is wrong.")
    max_spacing_difference: float = _limit(0.03, "fraction", "Recordings that differ more are of other grooves.")
    max_frequency_difference: float = _limit(0.25, "fraction", "Recordings that differ more are of other grooves.")
    min_frequency_change: float = _limit(0.02, "fraction", "A smaller change with speed or force is not reported.")
    change_confidence: float = _limit(0.95, "probability", "The confidence interval of a reported change excludes 0.")


@dataclass(frozen=True, slots=True)
class TextureLimits:
    """Thresholds of the fit of textures."""

    min_frequency_hz: float = _limit(20.0, "Hz", "A hand trembles at lower frequencies.")
    block_s: float = _limit(0.5, "s", "Strokes are cut into blocks of this length.")
    min_blocks: int = _limit(8, "blocks", "Fewer blocks give no useful interval.")
    min_block_speed: float = _limit(0.2, "fraction of the median speed", "A block with a slower sample is left out.")
    max_floor: float = _limit(0.05, "fraction of the peak", "A higher density near half the rate is refused.")
    min_density_fall: float = _limit(1.78, "ratio", "Two low poles cause this fall from 0.325 to 0.445 of the rate.")
    max_replaced: float = _limit(0.02, "fraction of a block", "A block with more replaced samples is left out.")
    knock_to_noise: float = _limit(15.0, "standard deviations of a block", "A larger acceleration is a knock.")
    max_knock_blocks: float = _limit(0.1, "fraction of the blocks", "More frequent knocks are a part of the texture.")
    max_tone_power: float = _limit(0.5, "fraction of the power", "A recording with a louder tone is not a texture.")
    max_jackknife_groups: int = _limit(20, "groups", "The jackknife leaves out each of at most this number of groups.")
    peak_level: float = _limit(0.5, "fraction of the peak", "The peak is that of a parabola fitted above this level.")
    narrow_peak_level: float = _limit(0.75, "fraction of the peak", "A second parabola, fitted above, checks the peak.")
    smoothing_hz: float = _limit(15.0, "Hz", "Densities are smoothed over this band on either side.")
    min_rms_m_per_s2: float = _limit(0.03, "m/s^2", "If the median block is weaker, the unit is wrong.")
    max_rms_m_per_s2: float = _limit(300.0, "m/s^2", "If the median block is stronger, the unit is wrong.")
    max_order: int = _limit(32, "coefficients", "An autoregressive model has at most this order.")
    min_model_blocks: int = _limit(4, "blocks", "A model needs this number of blocks at one speed and force.")
    max_model_difference: float = _limit(0.1, "fraction", "Speeds and forces within a model differ by less.")
    model_power: float = _limit(0.995, "fraction of the power", "This fraction lies below 0.4 of the models' rate.")
    max_frequency_scatter: float = _limit(0.3, "standard deviation of logarithms", "More scatter is not one texture.")
    min_frequency_step: float = _limit(0.15, "difference of logarithms", "A larger step begins a second texture.")
    min_loudness_step: float = _limit(0.4, "difference of logarithms", "A larger step begins a second texture.")
    step_to_error: float = _limit(6.0, "standard errors", "A smaller step may be due to chance.")
    min_frequency_change: float = _limit(0.05, "fraction", "A smaller change with speed or force is not reported.")
    change_confidence: float = _limit(0.99, "probability", "The confidence interval of a reported change excludes 0.")


@dataclass(frozen=True, slots=True)
class PunctureLimits:
    """Thresholds of the fit of punctures."""

    min_punctures: int = _limit(2, "punctures", "One puncture gives no interval.")
    max_drop_s: float = _limit(0.002, "s", "The force of a rupture drops within this time.")
    min_drop: float = _limit(0.5, "fraction of the force", "A smaller drop is not a rupture.")
    min_load: float = _limit(0.25, "fraction of the rupture force", "The stiffness is fitted above this force.")
    max_load: float = _limit(0.98, "fraction of the rupture force", "The stiffness is fitted below this force.")
    min_loaded_samples: int = _limit(20, "samples", "Fewer samples do not determine a stiffness.")
    min_r_squared: float = _limit(0.7, "r^2", "If force follows position less, columns are swapped.")
    max_depth_m: float = _limit(1.0, "m", "If the position has a larger range, the unit is wrong.")
    min_stiffness_n_per_m: float = _limit(MIN_STIFFNESS_N_PER_M, "N/m", "A softer membrane has a wrong unit.")
    max_stiffness_n_per_m: float = _limit(MAX_STIFFNESS_N_PER_M, "N/m", "A stiffer membrane has a wrong unit.")
    max_stiffness_change: float = _limit(0.1, "fraction", "A larger change of the stiffness is reported.")
    touch_load: float = _limit(0.02, "fraction of the load", "The touch is where the force exceeds this.")
    max_soft_depth: float = _limit(0.03, "fraction of the depth", "A deeper soft start is reported.")
    max_remaining_force: float = _limit(0.1, "fraction of the load", "A larger force after the rupture is reported.")
    min_second_drop_load: float = _limit(0.3, "fraction of the load", "Another drop from a higher force is refused.")
    before_rupture_s: float = _limit(0.01, "s", "The ringing is fitted from this time before the rupture.")
    after_rupture_s: float = _limit(0.08, "s", "The ringing is fitted to this time after the rupture.")
    max_replaced: float = _limit(0.02, "fraction of samples", "A puncture with more replaced samples is left out.")
    min_explained: float = _limit(0.7, "fraction of the variance", "A ringing that one mode explains less is left out.")
    well_explained: float = _limit(0.8, "fraction of the variance", "If one mode explains less, this is reported.")
    min_amplitude_m_per_s2: float = _limit(
        MIN_AMPLITUDE_M_PER_S2, "m/s^2", "If the median rupture is weaker, the unit is wrong."
    )
    max_amplitude_m_per_s2: float = _limit(
        MAX_AMPLITUDE_M_PER_S2, "m/s^2", "If the median rupture is stronger, the unit is wrong."
    )
    max_outlier_ratio: float = _limit(3.0, "ratio to the median", "A ringing farther from the median is left out.")
    max_outlier_fraction: float = _limit(0.25, "fraction of the punctures", "If more are outliers, all are used.")
    min_trend_punctures: int = _limit(4, "punctures", "Fewer punctures show no trend of amplitude with speed.")
    min_speed_span: float = _limit(0.2, "fraction of the mean speed", "Speeds of a smaller span are nearly equal.")
    min_amplitude_change: float = _limit(0.1, "fraction", "A smaller change with speed is not reported.")


PREPARATION_LIMITS: Final = PreparationLimits()
TAP_LIMITS: Final = TapLimits()
SPEED_LAW_LIMITS: Final = SpeedLawLimits()
WAVEFORM_LIMITS: Final = WaveformLimits()
RINGING_LIMITS: Final = RingingLimits()
LINE_LIMITS: Final = SpectralLineLimits()
GROOVE_LIMITS: Final = GrooveLimits()
TEXTURE_LIMITS: Final = TextureLimits()
PUNCTURE_LIMITS: Final = PunctureLimits()
