"""Thresholds of the fits, each with value, unit and reason; one dataclass for each kind of fit.

`make docs-tables` copies them to docs/fit.md. The thresholds that decide between good, fair and poor are in verdict.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, TypeVar

_T = TypeVar("_T")


def _limit(value: _T, unit: str, reason: str) -> _T:
    """Return a field of a dataclass with this default, and with unit and reason as its metadata."""
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True, slots=True)
class PreparationLimits:
    """Thresholds of the preparation for every fit: impossible samples, gaps, units, sampling rate."""

    max_force_n: float = _limit(200.0, "N", "No hand presses harder.")
    max_stroke_speed_m_per_s: float = _limit(5.0, "m/s", "No hand strokes or pierces faster.")
    max_acceleration_m_per_s2: float = _limit(1e5, "m/s^2", "Strokes and punctures stay below.")
    max_tap_acceleration_m_per_s2: float = _limit(1e6, "m/s^2", "A stylus that hits steel stays below.")
    max_beyond_limit: float = _limit(
        0.01, "fraction of samples", "If more of a column is beyond its limit, the unit or the column is wrong."
    )
    max_findings: int = _limit(
        50, "findings a column", "More spikes or standstills are part of the signal; more leaps are an error."
    )
    spike_to_noise: float = _limit(15.0, "standard deviations", "Noise does not deviate this far.")
    spike_ratio: float = _limit(8.0, "ratio", "A spike of acceleration exceeds the samples next to it by this factor.")
    max_spike_samples: int = _limit(3, "samples", "A spike of acceleration that lasts longer may be a contact.")
    max_spike_s: float = _limit(0.01, "s", "A spike of force or speed that lasts longer may be a motion of the hand.")
    min_standstill_s: float = _limit(0.05, "s", "Equal samples for a shorter time may be the sensor's resolution.")
    standstill_ratio: float = _limit(20.0, "ratio", "A standstill lasts longer than 99 % of the others by this factor.")
    leap_ratio: float = _limit(5.0, "ratio", "A leap exceeds 99 % of the other steps of the position by this factor.")
    max_leap_return_s: float = _limit(0.02, "s", "A position that returns within this time had a spike, not a leap.")
    min_complete: float = _limit(0.5, "fraction of samples", "A recording with fewer usable samples is left out.")
    min_samples_per_cycle: float = _limit(2.5, "samples", "At 2 a mode and its alias have the same samples.")
    min_acceleration_span_m_per_s2: float = _limit(0.02, "m/s^2", "A smaller change is not felt: a wrong unit.")
    min_force_n: float = _limit(1e-3, "N", "A smaller largest force is not felt: a wrong unit.")
    min_force_variation: float = _limit(
        0.2, "fraction of the mean", "With less variation the force gain is not determined."
    )
    max_stroke_m: float = _limit(5.0, "m", "No hand strokes farther: a wrong unit.")
    min_stroke_speed_m_per_s: float = _limit(1e-4, "m/s", "A slower stroke has a wrong unit or column.")
    max_speed_ratio: float = _limit(2.0, "ratio", "Speed column and position may differ by this ratio.")
    gravity_tolerance: float = _limit(0.02, "fraction", "A rest value this near to 1 or 96 m/s^2 is a wrong unit.")


@dataclass(frozen=True, slots=True)
class TapLimits:
    """Thresholds of the fit of taps that ring."""

    min_acceleration_m_per_s2: float = _limit(1e-3, "m/s^2", "A smaller largest acceleration has a wrong unit.")
    min_peak_to_noise: float = _limit(8.0, "ratio", "White noise alone does not reach this peak.")
    min_loud: float = _limit(0.05, "fraction of the peak", "Weaker samples do not belong to a tap.")
    min_quiet_s: float = _limit(0.02, "s", "Taps are separated by this time without a loud sample.")
    max_bounce_s: float = _limit(0.15, "s", "A weaker event this soon after a tap is its bounce.")
    max_bounce_size: float = _limit(0.8, "fraction of the tap before", "A larger event is a tap.")
    short_recording_s: float = _limit(
        0.5,
        "s",
        "A shorter recording may ring to its end, so its level and noise are those of the rest before the tap.",
    )
    max_rest_change: float = _limit(
        0.1,
        "fraction of the largest change",
        "The rest at the beginning of a recording ends where a change exceeds this.",
    )
    approach_s: float = _limit(0.01, "s", "The speed is the slope of the position over this time before the onset.")
    min_approach_samples: int = _limit(4, "samples", "Fewer positions do not determine a speed.")
    max_approach_residual: float = _limit(
        0.5, "fraction of the variance", "If a line leaves more of the position, the approach is not even."
    )
    min_rest_samples: int = _limit(2, "samples", "With less rest before a tap its offset is unknown.")
    certain_rest_samples: int = _limit(8, "samples", "With this rest before a tap its onset is not checked.")
    max_onset_error_samples: float = _limit(
        1.0, "samples", "With less rest, the onset must be known to this standard error."
    )
    min_samples_per_cycle: float = _limit(
        2.05, "samples", "Enough where the onset is known; at 2 amplitude and onset cannot be separated."
    )
    max_relative_error: float = _limit(
        0.5, "fraction", "A tap whose amplitude, decay or frequency has a larger standard error is left out."
    )
    min_shapeless_peak_to_noise: float = _limit(
        16.0, "ratio", "A louder tap with uncertain parameters is not too weak but has another shape."
    )
    min_decay_samples: float = _limit(2.0, "samples", "A faster decay is a glitch of the sensor.")
    fit_decay_times: float = _limit(7.0, "decay times", "A tap is fitted until then, when it is at a thousandth.")
    min_explained: float = _limit(0.5, "fraction of the variance", "A tap that a mode explains less is left out.")
    well_explained: float = _limit(
        0.95, "fraction of the variance", "Below, two modes are tried, and the verdict is poor if they do not help."
    )
    max_frequency_difference: float = _limit(0.1, "difference of logarithms", "Nearer frequencies are the same mode.")
    min_same_pairs: float = _limit(
        0.7,
        "fraction of the pairs",
        "If this fraction of the taps' mode pairs agrees, the material has both modes.",
    )
    min_second_gain: float = _limit(
        0.01, "fraction of the variance", "A second mode is offered if both explain this much more than one mode."
    )
    max_second_ratio: float = _limit(10.0, "ratio", "A second mode with a larger amplitude is an artefact of the fit.")
    min_second_periods: float = _limit(0.3, "periods", "A second mode that decays to 1/e sooner is a pulse.")
    max_residual_to_noise: float = _limit(
        1.3, "ratio", "A residual above this multiple of the noise before the onset is not only noise."
    )
    min_pattern: float = _limit(
        0.02, "fraction of the ringing, RMS", "A smaller pattern in the residuals is not reported."
    )
    max_other_sign: float = _limit(
        0.25, "fraction of the taps", "If more taps begin with the other sign, the recordings are refused."
    )
    min_frequency_hz: float = _limit(15.0, "Hz", "Slower motion is that of a hand.")
    max_decay: float = _limit(0.5, "fraction of the fitted time", "A ringing with a longer decay time does not decay.")
    min_frequency_change: float = _limit(0.02, "fraction", "A smaller change with speed needs no table of modes.")
    min_decay_change: float = _limit(0.1, "fraction", "A smaller change with speed needs no table of modes.")


@dataclass(frozen=True, slots=True)
class SpeedLawLimits:
    """Thresholds of the law of amplitude versus approach speed, for taps that ring and for pulses."""

    min_taps: int = _limit(3, "taps", "Fewer taps give no useful interval.")
    min_speed_m_per_s: float = _limit(1e-3, "m/s", "A slower tap has a wrong unit.")
    max_speed_m_per_s: float = _limit(10.0, "m/s", "A faster tap has a wrong unit.")
    min_speed_ratio: float = _limit(1.2, "ratio of fastest to slowest", "Below, the speeds do not determine a slope.")
    min_slope_to_angular: float = _limit(
        0.003,
        "slope over angular frequency",
        "The ratio is 1 for a mass that rings elastically, and 0.07 to 0.87 in "
        "Okamura et al. 1998: a smaller one has a wrong unit.",
    )
    max_slope_to_angular: float = _limit(10.0, "slope over angular frequency", "A larger one has a wrong unit.")
    significance: float = _limit(0.01, "probability", "An effect that chance makes more often is not significant.")
    min_bend: float = _limit(0.05, "RMS fraction of the line", "A law that differs less from the line is not used.")
    min_aicc_gain: float = _limit(2.0, "AICc", "The AICc of another law must be lower by this (Burnham 2002).")
    max_table_speeds: int = _limit(8, "speeds", "A material needs no finer table.")
    min_table_step: float = _limit(1.02, "ratio of neighbours", "Nearer speeds of a table are merged.")
    max_scatter: float = _limit(
        0.15, "RMS fraction of the law", "With less scatter about a law that is not a line, its r^2 is not judged."
    )
    min_outlier_distance: float = _limit(0.25, "fraction of the line", "A single tap farther off is reported.")


@dataclass(frozen=True, slots=True)
class WaveformLimits:
    """Thresholds of the fit of taps that are pulses, and of the choice between mode and waveform."""

    min_mode_periods: float = _limit(0.3, "periods", "A mode that decays to 1/e sooner does not ring: it is a pulse.")
    min_mode_explained: float = _limit(
        0.95, "fraction of the variance", "A ringing mode that explains this is taken without trying a waveform."
    )
    max_left_ratio: float = _limit(
        0.5,
        "ratio to what the mode leaves",
        "A waveform is taken if it leaves less of the variance unexplained than this.",
    )
    min_pulses: int = _limit(3, "pulses", "Fewer pulses give no useful interval.")
    large: float = _limit(0.6, "fraction of the peak", "The rise of a pulse ends where it exceeds this level.")
    crossing: float = _limit(0.25, "fraction of the peak", "Pulses are first aligned where they pass this level.")
    max_faint_energy: float = _limit(
        5e-4, "fraction of the energy", "Largest energy before the beginning or after the end of the waveform."
    )
    min_samples: int = _limit(8, "samples", "A curve with fewer samples has no shape.")
    max_coarse_loss: float = _limit(
        1e-4,
        "fraction of the variance",
        "The rate of the samples is halved while that loses no more of the variance.",
    )
    max_end: float = _limit(0.05, "fraction of the peak", "A waveform whose end is above this is faded out.")
    fade: float = _limit(0.2, "fraction of the length", "A waveform that does not end is faded out over its last part.")
    min_explained: float = _limit(
        0.5, "fraction of the variance", "A pulse that the waveform of the others explains less is left out."
    )
    error_to_change: float = _limit(
        4 / 3,
        "ratio",
        "Ratio of the error of samples to their change at twice the rate for an error of second order.",
    )
    max_groups: int = _limit(16, "groups", "With more pulses the jackknife leaves out groups of pulses.")


@dataclass(frozen=True, slots=True)
class RingingLimits:
    """Thresholds of the fit of decaying sinusoids, which taps and punctures share."""

    min_samples: int = _limit(16, "samples", "Fewer do not determine a mode.")
    judged_decay_times: float = _limit(5.0, "decay times", "The explained variance is that from the onset until then.")


@dataclass(frozen=True, slots=True)
class SpectralLineLimits:
    """Thresholds of the search for hum and other tones, in all fits."""

    min_frequency_hz: float = _limit(20.0, "Hz", "Slower motion is that of a hand.")
    max_chance: float = _limit(1e-3, "probability", "Noise alone has a line in one of a thousand recordings.")
    min_share: float = _limit(0.005, "fraction of the power", "A weaker line does not change the results.")
    max_same_hz: float = _limit(0.5, "Hz", "Lines of two recordings that are nearer are the same.")
    noise_band_hz: float = _limit(8.0, "Hz", "The noise near a line is measured over this band on each side.")
    min_recording_s: float = _limit(0.5, "s", "A shorter recording does not separate line and ringing.")
    max_named: int = _limit(5, "lines", "A report names the loudest ones only.")


@dataclass(frozen=True, slots=True)
class GrooveLimits:
    """Thresholds of the fit of grooves."""

    min_section_s: float = _limit(0.1, "s", "A shorter section between gaps and clipped samples is left out.")
    min_strikes: int = _limit(8, "strikes", "Fewer show no row of grooves.")
    min_strike: float = _limit(0.3, "fraction of strong strikes", "Weaker steps of the ringing are not strikes.")
    window_cycles: float = _limit(1.25, "cycles", "Length of ringing on either side that shows a strike at a sample.")
    strikes_in_group: int = _limit(8, "strikes", "Frequency and decay are fitted over groups of this size.")
    even_row: float = _limit(0.05, "RMS fraction of the spacing", "For a more even row no other damping is tried.")
    max_first_unevenness: float = _limit(0.22, "RMS fraction of the spacing", "Strikes at random positions have 0.29.")
    max_unevenness: float = _limit(0.12, "RMS fraction of the spacing", "A less even row is not one of grooves.")
    max_offset: float = _limit(0.25, "fraction of the spacing", "A strike farther from its groove is left out.")
    min_regular: float = _limit(0.7, "fraction of the strikes", "If fewer lie in the row, there are no grooves.")
    min_explained: float = _limit(
        0.5, "fraction of the variance", "A mode that explains less is not struck by grooves."
    )
    min_amplitude_m_per_s2: float = _limit(0.1, "m/s^2", "A weaker usual strike is not felt: a wrong unit.")
    max_amplitude_m_per_s2: float = _limit(5000.0, "m/s^2", "A stronger usual strike has a wrong unit.")
    max_spacing_difference: float = _limit(0.03, "fraction", "Recordings that differ more are of other grooves.")
    max_frequency_difference: float = _limit(0.25, "fraction", "Recordings that differ more are of other grooves.")
    min_frequency_change: float = _limit(0.02, "fraction", "A smaller change with speed or force is not reported.")
    change_confidence: float = _limit(0.95, "probability", "The interval of a reported change excludes 0.")


@dataclass(frozen=True, slots=True)
class TextureLimits:
    """Thresholds of the fit of textures."""

    min_frequency_hz: float = _limit(20.0, "Hz", "Below, a hand trembles.")
    block_s: float = _limit(0.5, "s", "Strokes are cut into blocks of this length.")
    min_blocks: int = _limit(8, "blocks", "Fewer blocks give no useful interval.")
    min_block_speed: float = _limit(0.2, "fraction of the median speed", "A block with a slower sample is left out.")
    max_floor: float = _limit(
        0.05, "fraction of the highest density", "If the density near half the rate is higher, the rate is too low."
    )
    min_density_fall: float = _limit(
        1.78,
        "ratio",
        "Least fall of a texture's density from 0.325 to 0.445 of the rate: that of noise with two low poles, made "
        "at this rate; a continuous signal falls more.",
    )
    max_replaced: float = _limit(0.02, "fraction of a block", "A block with more replaced samples is left out.")
    knock_to_noise: float = _limit(15.0, "standard deviations of a block", "Noise does not reach a knock.")
    max_knock_blocks: float = _limit(0.1, "fraction of the blocks", "With more knocks it is a texture of knocks.")
    max_tone: float = _limit(0.5, "fraction of the power", "A louder single tone is not a texture.")
    jackknife_groups: int = _limit(20, "groups", "The jackknife leaves out one of at most this number of groups.")
    wide_top: float = _limit(
        0.5, "fraction of the highest density", "The peak is that of a parabola fitted to higher densities."
    )
    narrow_top: float = _limit(
        0.75, "fraction of the highest density", "A second parabola, fitted to higher densities, checks the peak."
    )
    smoothing_hz: float = _limit(15.0, "Hz", "Densities are means over this band on either side.")
    min_rms_m_per_s2: float = _limit(0.03, "m/s^2", "A weaker usual block is not felt: a wrong unit.")
    max_rms_m_per_s2: float = _limit(300.0, "m/s^2", "A stronger usual block has a wrong unit.")
    max_order: int = _limit(32, "coefficients", "Largest order of an autoregressive model.")
    min_model_blocks: int = _limit(4, "blocks", "A speed and force held for a shorter time has no model.")
    max_model_difference: float = _limit(0.1, "fraction", "Speeds and forces within a model differ by less.")
    model_power: float = _limit(0.995, "fraction of the power", "This part lies below 0.4 of the rate of the models.")
    max_pitch_scatter: float = _limit(
        0.3, "standard deviation of the logarithm", "A mean frequency that scatters more is not of one texture."
    )
    min_pitch_step: float = _limit(0.15, "difference of logarithms", "A larger frequency step is a second texture.")
    min_loudness_step: float = _limit(0.4, "difference of logarithms", "A larger loudness step is a second texture.")
    step_to_error: float = _limit(6.0, "standard errors", "A step to a second texture is larger than this.")
    min_frequency_change: float = _limit(0.05, "fraction", "A smaller change with speed or force is not reported.")
    change_confidence: float = _limit(
        0.99, "probability", "The interval of a reported change excludes 0; chance seldom makes a good fit fair."
    )


@dataclass(frozen=True, slots=True)
class PunctureLimits:
    """Thresholds of the fit of punctures."""

    min_punctures: int = _limit(2, "punctures", "One puncture gives no interval.")
    max_drop_s: float = _limit(0.002, "s", "The force of a rupture falls within this time.")
    min_drop: float = _limit(0.5, "fraction of the force", "A smaller fall is not a rupture.")
    min_load: float = _limit(0.25, "fraction of the rupture force", "The stiffness is fitted from this force.")
    max_load: float = _limit(0.98, "fraction of the rupture force", "The stiffness is fitted up to this force.")
    min_loaded_samples: int = _limit(20, "samples", "Fewer do not determine a stiffness.")
    min_r_squared: float = _limit(0.7, "r^2", "Below, force does not follow position: swapped columns.")
    max_way_m: float = _limit(1.0, "m", "No puncture is deeper: a wrong unit.")
    min_stiffness_n_per_m: float = _limit(1.0, "N/m", "A softer membrane has a wrong unit.")
    max_stiffness_n_per_m: float = _limit(1e5, "N/m", "A stiffer membrane has a wrong unit.")
    max_stiffness_change: float = _limit(0.1, "fraction", "A larger change of the stiffness is reported.")
    soft_load: float = _limit(0.02, "fraction of the load", "The touch is where the force exceeds this.")
    max_soft_depth: float = _limit(
        0.03, "fraction of the depth", "If the touch is earlier than the line by more, a soft start is reported."
    )
    max_force_left: float = _limit(0.1, "fraction of the load", "A larger force after the rupture is reported.")
    second_rupture: float = _limit(
        0.3, "fraction of the load", "A recording with another drop from such a force is refused."
    )
    before_rupture_s: float = _limit(0.01, "s", "The ringing is fitted from this time before the rupture.")
    after_rupture_s: float = _limit(0.08, "s", "The ringing is fitted to this time after the rupture.")
    max_replaced: float = _limit(0.02, "fraction of samples", "With more replaced samples a puncture is left out.")
    min_explained: float = _limit(0.7, "fraction of the variance", "A ringing that one mode explains less is left out.")
    well_explained: float = _limit(
        0.8, "fraction of the variance", "A ringing that one mode explains less is reported."
    )
    min_amplitude_m_per_s2: float = _limit(0.1, "m/s^2", "A weaker usual rupture is not felt: a wrong unit.")
    max_amplitude_m_per_s2: float = _limit(3000.0, "m/s^2", "A stronger usual rupture has a wrong unit.")
    max_outlier_ratio: float = _limit(3.0, "ratio to the median", "A ringing farther from the median is left out.")
    max_outliers: float = _limit(0.25, "fraction of the punctures", "If more are far off, none is left out.")
    min_trend_punctures: int = _limit(4, "punctures", "Fewer do not show whether the amplitude follows the speed.")
    min_speed_span: float = _limit(
        0.2, "fraction of the mean speed", "With a smaller span the speeds are nearly equal."
    )
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
